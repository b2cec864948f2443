"""`bayesdrill check CONFIG`: what it shows of a record, and what it compares with nominal values."""

from pathlib import Path

import numpy as np
import pytest
from support import command_line
from support.case_tables import run_cases
from support.command_line import cli

from bayesdrill.config import loading
from bayesdrill.rig.models.motor_shaft import PARAMETERS as NINE

type Change = tuple[str, str]
LINES = command_line.small_record().splitlines()
CHANNEL = "w_1: {column: w_1, unit: rad/s, sigma: 0.05}"


def checked(config: Path) -> str:
    """Return what is printed of a config that is valid."""
    result = cli("check", config)
    assert result.status == 0, result.text
    return result.out


def test_two_samples_are_a_record(tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path)
    (tmp_path / "small.csv").write_text("\n".join(LINES[:3]) + "\n")
    checked(config)


def test_units_that_are_wrong_alike_and_a_stuck_sensor_are_suspected(tmp_path: Path) -> None:
    t, angle, speed = np.array([line.split(",") for line in LINES[1:]], dtype=float).T
    stuck = np.where((t > 1.99) & (t < 2.71), speed[40], speed)
    for columns, message in (
        (np.degrees([angle, speed]), "w_1 is 57.3 times what the start values predict"),
        ((angle, stuck), "stuck: w_1 stays at exactly one value for 15 samples, from 2 to 2.7 s"),
    ):
        config = command_line.small_config(tmp_path)
        rows = [",".join(f"{x:.9g}" for x in row) for row in zip(t, *columns, strict=True)]
        (tmp_path / "small.csv").write_text("\n".join([LINES[0], *rows]) + "\n")
        assert message in checked(config)


def test_a_differenced_speed_is_suspected_until_it_is_declared(tmp_path: Path) -> None:
    t, angle, _ = np.array([line.split(",") for line in LINES[1:]], dtype=float).T
    speed = np.diff(angle, prepend=angle[0]) * 20.0
    rows = [f"{a:.9g},{b:.9g},{c:.9g}" for a, b, c in zip(t, angle, speed, strict=True)]
    outputs = []
    for channel in (CHANNEL, CHANNEL[:-1] + ", derived_from: theta_1}"):
        config = command_line.small_config(tmp_path, (CHANNEL, channel))
        (tmp_path / "small.csv").write_text("\n".join([LINES[0], *rows]) + "\n")
        outputs.append(checked(config))
    suspected, declared = outputs
    assert "record, derived: the noise of w_1 is that of differences of theta_1" in suspected
    assert "record, derived" not in declared
    assert "w_1 is not counted, as it is derived from theta_1" in declared
    assert "101 samples of theta_1 over" in declared


def test_a_config_without_mistakes_is_said_to_have_none_and_its_doubts_are_counted(
    tmp_path: Path,
) -> None:
    energy, sampling = ("k_T: nominal", "k_T: 0.06"), ("l_m: nominal", "l_m: 0.05")
    doubts = {
        (): " 2 of the lines above are doubts about its values or its record.",
        (energy,): " 1 of the lines above is a doubt about its values or its record.",
        (energy, sampling): "",
    }
    for changes, said in doubts.items():
        shown = checked(command_line.small_config(tmp_path, *changes))
        assert shown.endswith(f"\nThe config has no mistakes and can be sampled.{said}\n")
    drafted = ("parameters:", "# REVIEW: no sheet\nparameters:")
    shown = checked(command_line.small_config(tmp_path, energy, sampling, drafted))
    assert shown.endswith(" can be sampled. 1 line marked REVIEW is left to look at.\n")


@pytest.mark.slow
def test_the_size_of_the_results_is_estimated_and_long_records_get_fewer_draws(
    tmp_path: Path,
) -> None:
    """12 predictive draws of each ensemble would fit, but are too few for the tails."""
    config = command_line.small_config(
        tmp_path, ("duration: 5, rate: 20", "duration: 5, rate: 40000")
    )
    command_line.simulate_again(config)
    out = checked(config)
    assert "size at most: chain 0.384 MB (500 steps), 10 predictive draws" in out
    command_line.replace_text(config, "predictive_draws: 10", "predictive_draws: 125")
    assert "no predictive draws: 125 of each ensemble are too many" in checked(config)
    command_line.replace_text(config, "rate: 40000", "rate: 16000")
    command_line.simulate_again(config)
    out = checked(config)
    assert "31 predictive draws of each ensemble" in out
    assert "not 125" in out


# Another rig than that of the paper: values and priors of its own, and no word of a table.
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
OWN_VALUES = "j_m: 1, c_m: 1, k_e: 0.2, k_T: 0.2, r_m: 1, l_m: 1, k_s: 1, j_1: 0.1, t_f: 1"


@run_cases(
    "changes, entry, compared, name",
    [
        ((), None, set(NINE), "the nominal table (tables_2_3)"),
        ((), "table_1", set(NINE), "the nominal table (table_1)"),
        (OTHER, None, set(), None),
        (OTHER, "{tolerance: 0.1}", set(), None),
        (OTHER, "{tolerance: {default: 0.1, j_1: 0.2}}", set(), None),
        (OTHER, "tables_2_3", set(NINE), "the nominal table (tables_2_3)"),
        (OTHER, "{j_1: 0.1}", {"j_1"}, "the config's nominal values"),
        (OTHER, f"{{{OWN_VALUES}}}", set(NINE), "the config's nominal values"),
        (
            OTHER,
            "{table: table_1, j_1: 0.1}",
            set(NINE),
            "the nominal table (table_1, with j_1 as in the config)",
        ),
        ((), "{j_1: 0.03}", set(NINE), "the nominal table (tables_2_3, with j_1 as in the config)"),
    ],
)
def test_a_rig_is_compared_with_the_table_that_it_asks_for(
    changes: tuple[Change, ...],
    entry: str | None,
    compared: set[str],
    name: str | None,
    tmp_path: Path,
) -> None:
    given = [("map: {", f"nominal: {entry}\nmap: {{")] if entry else []
    config = command_line.small_config(tmp_path, *changes, *given)
    nominal = loading.load(config).experiments[0].nominal
    assert set(nominal.compared) == compared
    assert name in (None, nominal.name)


def test_a_record_in_the_place_of_a_config_is_named_as_one(tmp_path: Path) -> None:
    command_line.small_config(tmp_path)
    message = "is a record, and no config; `bayesdrill init` writes a config for it"
    command_line.assert_refused(cli("check", tmp_path / "small.csv"), message)
