"""Several experiments in one config: what each reads, what they share, and mistakes at their places."""

from __future__ import annotations

from pathlib import Path

import pairs
import pytest
from together import for_each

from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
from bayesdrill.config.job import prepare

SLOW = "  slow: {record: {file: slow.csv}, inputs: {v: 4.0}}\n"
FAST = "  fast: {record: {file: fast.csv}}\n"
SHARED = "shared: [lag_theta_1, offset_theta_1]"
OFFSET = "offset: {prior: normal, mean: 0, sd: 10}"
ALL = f"experiments:\n{SLOW}{FAST}"


def problems(folder: Path, *changes: tuple[str, str]) -> list[tuple[str, str]]:
    """Places without file and line, and messages."""
    with pytest.raises(InputError) as caught:
        prepare(pairs.write(folder, *changes))
    found = []
    for one in caught.value.problems:
        line, _, place = one.place.partition(": ")
        assert line.rpartition(":")[2].isdigit(), one
        found.append((place, one.message))
    return found


def fast(entry: str) -> tuple[str, str]:
    return FAST, f"  fast: {entry}\n"


WHERE = "experiments.fast.record"
CASES = [
    ("a name with a dash", [("  slow:", "  slow-1:")], "experiments.slow-1", "cannot name"),
    ("a list", [(ALL, "experiments: [slow, fast]\n")], "experiments", "`key: value` entries"),
    ("none", [(ALL, "experiments: {}\n")], "experiments", "no experiment stands here"),
    ("nothing", [(ALL, "experiments:\n")], "experiments", "no experiment stands here"),
    ("one is text", [fast("fast.csv")], "experiments.fast", "`key: value` entries"),
    ("one is nothing", [fast("")], "experiments.fast", "`key: value` entries"),
    ("a section misspelt", [fast("{record: {file: fast.csv}, input: {v: 3}}")],
     "experiments.fast.input", "did you mean inputs?"),
    ("what is no section", [fast("{record: {file: fast.csv}, sampler: {ess: 1}}")],
     "experiments.fast.sampler", "known: held_out, initial, inputs, parameters, record"),
    ("no record", [fast("{inputs: {v: 3}}")], f"{WHERE}.file", "this experiment has no record"),
    ("a record that is text", [fast("{record: fast.csv}")], WHERE, "`key: value` entries"),
    ("a key of its record", [fast("{record: {file: fast.csv, windw: [0, 1]}}")],
     f"{WHERE}.windw", "did you mean window?"),
    ("a unit of its channel", [fast("{record: {file: fast.csv, channels: {theta_1: {unit: rpm}}}}")],
     f"{WHERE}.channels.theta_1.unit", "'rpm' is not a unit of rad"),
    ("no file", [fast("{record: {file: fasst.csv}}")], f"{WHERE}.file", "did you mean fast.csv?"),
    ("no column", [fast("{record: {file: fast.csv, channels: {w_1: {column: w1}}}}")],
     f"{WHERE}.channels.w_1.column", "w_1"),
    ("its window", [fast("{record: {file: fast.csv, window: [9, 10]}}")],
     f"{WHERE}.window", "no sample lies in it"),
    ("its start", [fast("{record: {file: fast.csv}, initial: {time: 2}}")],
     "experiments.fast.initial.time", "after the first sample"),
    ("shared without experiments", [(ALL, ""), ("time: {column", "file: fast.csv\n  time: {column")],
     "shared", "there is one experiment alone"),
    ("shared of the rig", [(SHARED, "shared: [j_1]")], "shared.0", "parameters of the rig are shared"),
    ("shared misspelt", [(SHARED, "shared: [lag_theta1]")], "shared.0", "did you mean lag_theta_1?"),
    ("shared and held", [(OFFSET, "offset: 1.0")], "shared.1", "is held"),
    ("shared and other", [fast("{record: {file: fast.csv, channels: {theta_1: {offset: {sd: 9}}}}}")],
     "shared.1", "another prior in fast than in slow"),
    ("shared of one", [fast("{record: {file: fast.csv, channels: {theta_1: {offset: null}}}}")],
     "shared.1", "only slow has offset_theta_1"),
    ("shared and free", [(SHARED, "shared: [w_1_0]\ninitial: {w_1: free}")],
     "shared.0", "a prior of its own"),
    ("own misspelt", [(SHARED, f"{SHARED}\nown: [j1]")], "own.0", "did you mean j_1?"),
    ("own and held", [(SHARED, f"{SHARED}\nown: [k_s]")], "own.0", "no unknown parameter"),
    ("own and tied", [(SHARED, f"{SHARED}\nown: [k_e]"), ("k_T: nominal", "k_T: {tie: k_e}")],
     "own.0", "so that all experiments share it"),
    ("a name that is taken",
     [("  slow:", "  x:"), ("  fast:", "  w_1_x:"), (SHARED, "shared: []"),
      ("w_1: {column", "theta_1_w_1: {column: theta_1, unit: deg, measures: theta_1, sigma: 3, "
       f"{OFFSET}}}\n    w_1: {{column")],
     "experiments.w_1_x", "rename the experiment"),
    ("too few walkers for all", [("walkers: 16", "walkers: 8"), (SHARED, "shared: []")],
     "sampler.walkers", "at least twice the 6 unknowns"),
    ("a figure of what is not", [("figures: []", "figures: [], corner: [lag_theta_1_slow]")],
     "output.corner.0", "is neither unknown nor derived"),
    ("a true value of one of what all share", [("truth: {lag_theta_1", "truth: {lag_theta_1_slow")],
     "simulation.truth.lag_theta_1_slow", "no such unknown"),
]  # fmt: skip


def test_a_mistake_is_told_where_it_stands(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Once, with its line, and nothing else with it."""

    def check(name: str, changes: list[tuple[str, str]], place: str, says: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        found = problems(tmp_path, *changes)
        assert [where for where, _ in found] == [place], found
        assert says in found[0][1], found

    for_each({c[0]: c for c in CASES}, check)


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
    assert {where for where, _ in found} == {"experiments.slow.record.file", f"{WHERE}.window"}


def test_an_experiment_reads_as_if_it_were_alone(tmp_path: Path) -> None:
    """Entries of its own stand over common ones, mapping by mapping; a kind that differs, instead."""
    own = "{record: {file: fast.csv, channels: {w_1: {sigma: 3}}}, inputs: {v: {column: w_1, unit: V}}}"
    slow, quick = loading.load(pairs.write(tmp_path, fast(own))).experiments
    assert (slow.label, quick.label) == ("slow", "fast")
    assert slow.config.inputs.v == 4.0
    assert slow.config.record.channels["w_1"].sigma == 0.1
    channel = quick.config.record.channels["w_1"]
    assert (channel.sigma, channel.unit, channel.column) == (3.0, "rad/s", "w_1")
    assert quick.config.inputs.v.column == "w_1"  # type: ignore[union-attr]


def test_names_say_whose_an_unknown_is(tmp_path: Path) -> None:
    changes = (SHARED, "shared: [lag_theta_1]\nown: [j_1]")
    job = prepare(pairs.write(tmp_path, changes))
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
