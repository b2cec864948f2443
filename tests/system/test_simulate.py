"""`bayesdrill simulate CONFIG`: records that their config can read, and that replace no other file."""

import os
from pathlib import Path

import numpy as np
import pytest
from support import command_line
from support.case_tables import run_cases
from support.command_line import assert_refused, assert_refused_unchanged, cli, listing

from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
from bayesdrill.config.records import reading, simulation

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
    entry = ("  file: small.csv", f"  file: other.txt\n  {FORMS[form]}")
    (experiment,) = loading.load(command_line.small_config(tmp_path, entry)).experiments
    grid = simulation.simulation_grid(experiment)
    y = np.random.default_rng(3).normal(size=(len(grid.t), 2)) * [1e-3, 1e4]
    text = simulation.record_text(experiment, grid, y)
    (tmp_path / "other.txt").write_text(text, encoding="utf-8")
    record = reading.read(experiment)
    np.testing.assert_allclose(record.t, grid.t, rtol=1e-8)
    np.testing.assert_allclose(record.y, y, rtol=1e-8)


@run_cases("old, new, message", command_line.REFUSALS["simulate"])
def test_a_record_that_its_config_could_not_read_is_not_written(
    old: str, new: str, message: str, tmp_path: Path
) -> None:
    config = command_line.small_config(tmp_path, (old, new))
    before = listing(tmp_path)
    target = ["-o", tmp_path / "new.csv"] if old.startswith("rad/s") else []
    assert_refused(cli("simulate", config, "--force", *target), message)
    assert listing(tmp_path) == before


def test_another_simulation_is_overwritten_with_force_only(tmp_path: Path) -> None:
    """The same config and seed give the same record."""
    config, other = command_line.small_config(tmp_path), tmp_path / "other.csv"
    record = (tmp_path / "small.csv").read_bytes()
    assert cli("simulate", config, "-o", other).status == 0
    assert other.read_bytes() == record
    command = ("simulate", config, "-o", other, "--seed", "8")
    assert_refused_unchanged(tmp_path, "other.csv: exists already; give --force", *command)
    assert cli(*command, "--force").status == 0
    assert other.read_bytes() != record
    (tmp_path / "small.csv").unlink()
    assert cli("simulate", config).status == 0
    assert (tmp_path / "small.csv").read_bytes() == record


def test_a_config_of_known_values_simulates_although_nothing_can_be_fitted(tmp_path: Path) -> None:
    box = "{prior: uniform, low: 0.5, high: 1.5, relative: true}"
    values = [(f"{name}: {box}", f"{name}: nominal") for name in ("k_e", "j_1")]
    config = command_line.small_config(tmp_path, *values)
    assert cli("simulate", config, "-o", tmp_path / "new.csv").status == 0
    assert_refused(cli("check", config), "parameters: no parameter is unknown")


@run_cases("force", [False, True])
@run_cases("name", ["thesis.tex", "longer", "empty", "pipe", "link", "folder"])
def test_simulate_replaces_nothing_but_a_record(name: str, force: bool, tmp_path: Path) -> None:
    files = {"thesis.tex": "t,theta", "longer": "t,theta_1,w_1\n0,0,0\n", "empty": ""}
    for file, text in files.items():
        (tmp_path / file).write_text(text)
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("thesis.tex")
    (tmp_path / "folder").mkdir()
    never = {"pipe": "a device or pipe, ", "link": "a link, ", "folder": "a folder, "}
    message = never.get(name, "is no record with these columns" if force else "exists already")
    before = listing(tmp_path)
    with pytest.raises(InputError, match=message):
        simulation.check_target(
            "t,theta_1\n0,0\n", tmp_path / name, [tmp_path / "none.csv"], force=force
        )
    assert listing(tmp_path) == before
