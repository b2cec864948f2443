"""Several experiments in one config: what each reads, what they share, and mistakes at their places."""

from __future__ import annotations

from pathlib import Path

import pytest
from support import two_experiments
from support.config_mistakes import check_mistakes

from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
from bayesdrill.config.job import prepare

SLOW = "  slow: {record: {file: slow.csv}, inputs: {v: 4.0}}\n"
FAST = "  fast: {record: {file: fast.csv}}\n"
SHARED = "shared: [lag_theta_1, offset_theta_1]"


def problems(folder: Path, *changes: tuple[str, str]) -> list[tuple[str, str]]:
    """Places without file and line, and messages."""
    with pytest.raises(InputError) as caught:
        prepare(two_experiments.write(folder, *changes))
    found = []
    for one in caught.value.problems:
        line, _, place = one.place.partition(": ")
        assert line.rpartition(":")[2].isdigit(), one
        found.append((place, one.message))
    return found


def fast(entry: str) -> tuple[str, str]:
    return FAST, f"  fast: {entry}\n"


def test_a_mistake_is_told_where_it_stands(tmp_path_factory: pytest.TempPathFactory) -> None:
    def load(folder: Path, *changes: tuple[str, str]) -> object:
        return prepare(two_experiments.write(folder, *changes))

    check_mistakes("experiments", tmp_path_factory, load)


def test_mistakes_of_all_experiments_are_told_at_once(tmp_path: Path) -> None:
    """Those of the config; then those of the records."""
    slow = (SLOW, "  slow: {record: {file: slow.csv, windw: 1}}\n")
    found = problems(tmp_path, slow, fast("{inputs: {v: [3]}}"), ("k_s: nominal", "k_s: nominl"))
    assert {where for where, _ in found} == {
        "experiments.slow.record.windw",
        "experiments.fast.record.file",
        "experiments.fast.inputs.v",
        "parameters.k_s",
    }
    slow = (SLOW, "  slow: {record: {file: slw.csv}}\n")
    found = problems(tmp_path, slow, fast("{record: {file: fast.csv, window: [9, 10]}}"))
    assert {where for where, _ in found} == {
        "experiments.slow.record.file",
        "experiments.fast.record.window",
    }


def test_an_experiment_reads_as_if_it_were_alone(tmp_path: Path) -> None:
    """Entries of its own stand over common ones, mapping by mapping; a kind that differs, instead."""
    own = "{record: {file: fast.csv, channels: {w_1: {sigma: 3}}}, inputs: {v: {column: w_1, unit: V}}}"
    slow, quick = loading.load(two_experiments.write(tmp_path, fast(own))).experiments
    assert (slow.label, quick.label) == ("slow", "fast")
    assert slow.config.inputs.v == 4.0
    assert slow.config.record.channels["w_1"].sigma == 0.1
    channel = quick.config.record.channels["w_1"]
    assert (channel.sigma, channel.unit, channel.column) == (3.0, "rad/s", "w_1")
    assert quick.config.inputs.v.column == "w_1"  # type: ignore[union-attr]


def test_names_say_whose_an_unknown_is(tmp_path: Path) -> None:
    changes = (SHARED, "shared: [lag_theta_1]\nown: [j_1]")
    job = prepare(two_experiments.write(tmp_path, changes))
    assert job.problem.names == (
        "k_e",
        "j_1_slow",
        "j_1_fast",
        "offset_theta_1_slow",
        "lag_theta_1",
        "offset_theta_1_fast",
    )
    nominal = job.problem.nominal
    assert nominal["j_1_slow"] == nominal["j_1_fast"] == nominal["j_1"]
    assert {"j_1_slow", "j_1_fast"} <= job.problem.published
    meanings = {symbol.name: symbol.meaning for symbol in job.problem.symbols}
    assert meanings["j_1_fast"].endswith("of the experiment fast")
    assert "experiment" not in meanings["lag_theta_1"]
