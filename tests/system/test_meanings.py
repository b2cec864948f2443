"""What a config means by a name, a unit, a formula: refused where it can only be meant otherwise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import command_line
from support.case_tables import run_cases

from bayesdrill.config import loading
from bayesdrill.config.records import reading, simulation
from bayesdrill.rig.models.motor_shaft import PARAMETERS as NINE

type Change = tuple[str, str]


@run_cases(
    "unit", ["rpm", "deg/s", "revolution/s", "turn/min", "mrad/s", "cycle/hour", "degree/ms"]
)
def test_units_that_say_how_far_they_turn_are_read(unit: str, tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path, ("unit: rad/s", f"unit: {unit}"))
    assert command_line.cli("check", config).status == 0


@run_cases(
    "entry",
    [
        ("t_f: nominal", "t_f: 0"),
        ("t_f: nominal", "t_f: -0.05"),
        ("c_m: nominal", "c_m: 0"),
        ("t_f: nominal", "t_f: {prior: normal, mean: 0, sd: 0.1}"),
        ("t_f: nominal", "t_f: {prior: truncated_normal, mean: -0.1, sd: 0.1, low: 0, high: 0.5}"),
        ("rate: 20", "rate: 20, t_f: 0, c_m: 0"),
    ],
    ids=lambda entry: entry[1],
)
def test_a_motor_without_friction_or_with_that_of_the_other_way_can_be_meant(
    entry: Change, tmp_path: Path
) -> None:
    assert command_line.cli("check", command_line.small_config(tmp_path, entry)).status == 0


def test_the_true_values_of_a_rig_without_friction_are_found(tmp_path: Path) -> None:
    config = command_line.small_config(
        tmp_path, ("t_f: nominal", "t_f: 0"), ("c_m: nominal", "c_m: 0")
    )
    command_line.simulate_again(config)
    found = command_line.cli("map", config, "--processes", "1")
    assert found.status == 0, found.err
    for name in ("k_e", "j_1"):
        (line,) = (x for x in found.out.splitlines() if x.startswith(f"{name} "))
        assert abs(float(line.split()[-1])) < 0.1  # per cent off nominal, which is the truth


FORMS = {
    "semicolons": "delimiter: ';'",
    "decimal comma": "decimal: ','",
    "bars and decimal comma": "delimiter: '|'\n  decimal: ','",
    "white space": "delimiter: ' '\n  header: true",
    "tabs": 'delimiter: "\\t"',
    "skipped rows": "skip_rows: 3",
}


@run_cases("form", FORMS)
def test_a_simulated_record_is_written_as_its_config_reads_it(form: str, tmp_path: Path) -> None:
    path = command_line.small_config(
        tmp_path, ("  file: small.csv", f"  file: other.txt\n  {FORMS[form]}")
    )
    (one,) = loading.load(path).experiments
    grid = simulation.simulation_grid(one)
    y = np.random.default_rng(3).normal(size=(len(grid.t), 2)) * [1e-3, 1e4]
    text = simulation.record_text(one, grid, y)
    (tmp_path / "other.txt").write_text(text, encoding="utf-8")
    read = reading.read(one)
    np.testing.assert_allclose(read.t, grid.t, rtol=1e-8)
    np.testing.assert_allclose(read.y, y, rtol=1e-8)


def test_the_samples_of_a_simulated_record_are_counted(tmp_path: Path) -> None:
    other = ("  file: small.csv", "  file: other.csv\n  skip_rows: 3")
    made = command_line.cli("simulate", command_line.small_config(tmp_path, other))
    assert made.status == 0, made.err
    assert made.out.endswith("101 samples\n")


UNREADABLE: dict[str, tuple[Change, str]] = {
    "mat": (("file: small.csv", "file: other.mat"), "record.file: a simulated record is text"),
    "ending": (("file: small.csv", "file: other.foo"), "the ending '.foo' is unknown"),
    "no header": (
        ("file: small.csv", "file: other.csv\n  header: false"),
        "record.header: a simulated record has a header",
    ),
    "impossible delimiter": (
        ("file: small.csv", "file: other.csv\n  delimiter: ab"),
        "delimiter 'ab' is not one character",
    ),
    "name that is a number": (("column: t,", "column: nan,"), "mixes numbers and text"),
    "name of a comment": (("column: t,", "column: '%',"), "no column '%'"),
    "name twice": (("column: t,", "column: w_1,"), "stands 2 times in the header"),
}


@run_cases("name", UNREADABLE)
def test_a_record_that_its_config_could_not_read_is_not_written(name: str, tmp_path: Path) -> None:
    change, says = UNREADABLE[name]
    config = command_line.small_config(tmp_path, change)
    before = command_line.listing(tmp_path)
    ran = command_line.cli("simulate", config, "--force")
    assert ran.status == 2
    assert says in ran.err
    assert command_line.listing(tmp_path) == before


def test_a_target_that_the_config_could_not_read_is_not_written(tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path)
    ran = command_line.cli("simulate", config, "--output", tmp_path / "other.mat")
    assert ran.status == 2
    assert "name a .csv file" in ran.err
    assert not (tmp_path / "other.mat").exists()


def test_check_shows_each_column_as_the_file_has_it(tmp_path: Path) -> None:
    """So that swapped columns, wrong units and a wrong rate show."""
    config = command_line.small_config(
        tmp_path, ("unit: rad,", "unit: deg,"), ("unit: s}", "unit: min}")
    )
    rows = [line.split(",") for line in command_line.small_record().splitlines()[1:]]
    numbers = [[float(cell) for cell in column] for column in zip(*rows, strict=True)]
    lines = command_line.cli("check", config).out.splitlines()
    head = next(n for n, line in enumerate(lines) if line.startswith("columns ("))
    assert lines[head] == "columns (a sample every 3 s (0.333333 Hz), the first at 0 s):"
    assert lines[head + 1].split() == ["measures", "column", "unit", "first", "from", "to"]
    names = [("time", "t", "min"), ("theta_1", "theta_1", "deg"), ("w_1", "w_1", "rad/s")]
    for line, (name, column, unit), values in zip(lines[head + 2 :], names, numbers, strict=False):
        shown = [f"{x:.5g}" for x in (values[0], min(values), max(values))]
        assert line.split() == [name, name, column, unit, *shown]


def test_a_rig_that_turns_backwards_is_told_that_friction_drives_it(tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path, ("v: 8.0", "v: -8.0"))
    command_line.simulate_again(config)
    assert "friction: in 9" in command_line.cli("check", config).out.splitlines()[-1]


# A rig of which the paper knows nothing: values and priors of its own, and no word of a table.
OTHER: tuple[Change, ...] = (
    ("j_m: nominal", "j_m: 5e-4"),
    ("c_m: nominal", "c_m: 2e-4"),
    ("k_e: {prior: uniform, low: 0.5, high: 1.5, relative: true}", "k_e: {tie: k_T}"),
    ("k_T: nominal", "k_T: {prior: uniform, low: 0.1, high: 0.3}"),
    ("r_m: nominal", "r_m: 0.5"),
    ("l_m: nominal", "l_m: 1e-3"),
    ("k_s: nominal", "k_s: 2.0"),
    ("j_1: {prior: uniform, low: 0.5, high: 1.5, relative: true}", "j_1: {prior: log_normal, "
     "median: 0.1, sd_log: 0.3}"),
    ("t_f: nominal", "t_f: 0.05"),
)  # fmt: skip


def nominal_of(
    folder: Path, *changes: Change, say: str | None = None
) -> tuple[Path, set[str], str]:
    """A config, the parameters that it compares with something, and what it calls that."""
    given = [("map: {", f"nominal: {say}\nmap: {{")] if say else []
    path = command_line.small_config(folder, *changes, *given)
    nominal = loading.load(path).experiments[0].nominal
    return path, set(nominal.compared), nominal.name


OWN_VALUES = "j_m: 1, c_m: 1, k_e: 0.2, k_T: 0.2, r_m: 1, l_m: 1, k_s: 1, j_1: 0.1, t_f: 1"


@run_cases(
    "changes, say, compared, called",
    [
        ((), None, set(NINE), "tables_2_3"),
        ((), "table_1", set(NINE), "table_1"),
        (OTHER, None, set(), None),
        (OTHER, "{tolerance: 0.1}", set(), None),
        (OTHER, "tables_2_3", set(NINE), "tables_2_3"),
        (OTHER, "{j_1: 0.1}", {"j_1"}, "the config's nominal values"),
        (OTHER, f"{{{OWN_VALUES}}}", set(NINE), "the config's nominal values"),
        (OTHER, "{table: table_1, j_1: 0.1}", set(NINE), "table_1 (j_1 as in the config)"),
        ((), "{j_1: 0.03}", set(NINE), "tables_2_3 (j_1 as in the config)"),
    ],
)
def test_a_table_speaks_only_of_the_rig_that_asks_for_it(
    changes: tuple[Change, ...],
    say: str | None,
    compared: set[str],
    called: str | None,
    tmp_path: Path,
) -> None:
    _, found, name = nominal_of(tmp_path, *changes, say=say)
    assert found == compared
    assert called in (None, name)


def test_nothing_of_the_paper_is_said_of_another_rig(tmp_path: Path) -> None:
    """Its k_T is not 1.99 times its k_e, its shaft is not the paper's, and starts are its own."""
    config, *_ = nominal_of(tmp_path, *OTHER)
    command_line.simulate_again(config)
    said = command_line.cli("check", config).out
    assert "nominal" not in said
    assert "energy" not in said
    assert "geometry" not in said
    resolved = command_line.cli("map", config, "--processes", "1")
    assert resolved.status == 0, resolved.err
    (line,) = (x for x in resolved.out.splitlines() if x.startswith("k_T "))
    assert line.split()[1:] == ["N", "m/A", line.split()[-1]]  # no nominal value, no deviation
    assert abs(float(line.split()[-1]) / 0.2 - 1) < 0.01  # the median, which is where the truth is


@pytest.mark.slow
def test_a_run_and_its_report_of_a_rig_without_nominal_values(tmp_path: Path) -> None:
    config, *_ = nominal_of(tmp_path, *OTHER)
    command_line.simulate_again(config)
    folder = tmp_path / "out"
    ran = command_line.cli("posterior", config, "--output", folder, "--processes", "1")
    assert ran.status in (0, 3), ran.err
    assert "tables_2_3" not in ran.out + (folder / "config.resolved.yaml").read_text()
    again = command_line.cli("report", folder, "--processes", "1")
    assert (again.status, again.err) == (ran.status, "")
    assert not (folder / "verdict.csv").exists()
