"""Several files of one rig, and several records in one file."""

import itertools
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from support.case_tables import run_cases
from support.first_configs import (
    DEG,
    RPM,
    SPEED,
    T,
    channels_of,
    draft_of,
    german_record,
    refusal,
    repeated,
    reversing_rig,
    write_table,
)
from support.small_problems import starts_believed

import bayesdrill as bd
from bayesdrill.config import loading
from bayesdrill.config.records import reading
from bayesdrill.drafting import record_files

Columns = dict[str, np.ndarray]


def split_rows(columns: Columns, *edges: int) -> list[Columns]:
    """Rows from each edge to the next, with times from 0."""
    parts = [{name: x[a:b] for name, x in columns.items()} for a, b in itertools.pairwise(edges)]
    return [{**part, "Zeit_ms": part["Zeit_ms"] - part["Zeit_ms"][0]} for part in parts]


@starts_believed()
def test_files_of_one_kind_are_experiments_of_one_config(tmp_path: Path) -> None:
    """What they have in common stands once; the second begins in motion, the first at rest."""
    fast, slow = split_rows(german_record(), 0, 900, 1600)
    paths = [
        write_table(tmp_path / "test 2 fast.csv", fast),
        write_table(tmp_path / "test 2 slow.csv", slow),
    ]
    draft = draft_of(paths, config=tmp_path / "both.yaml")
    assert channels_of(draft).keys() == {"theta_1", "w_1", "motor"}
    assert "file" not in draft["record"]
    assert draft["experiments"] == {
        "fast": {"record": {"file": "test 2 fast.csv"}},
        "slow": {"record": {"file": "test 2 slow.csv"}, "initial": "free"},
    }
    assert draft["shared"] == ["t_0", "offset_v", "sigma_theta_1", "sigma_w_1", "sigma_motor"]
    assert "experiments fast, slow; channels theta_1, w_1, motor" in draft["said"]
    assert bd.init(paths).path == tmp_path / "test_2.yaml"


def test_meanings_are_those_of_the_most_informative_file(tmp_path: Path) -> None:
    """The rotor hardly moves in the first file, so that its unit cannot be told there."""
    t, v, x = reversing_rig()
    rng = np.random.default_rng(3)

    def columns(share: float) -> Columns:
        return {
            "t [s]": t,
            "U": share * v,
            "phi": share * x[:, 0] * DEG + rng.normal(0, 0.3, len(t)),
            "speed": share * x[:, 2] * RPM + rng.normal(0, 0.3, len(t)),
        }

    paths = [write_table(tmp_path / f"{n}.csv", columns(s)) for n, s in (("a", 1e-5), ("b", 1.0))]
    draft = draft_of(paths, config=tmp_path / "both.yaml")
    assert {unit for _, unit in channels_of(draft).values()} == {"deg", "rpm"}
    assert channels_of(draft_of(paths[0])) != channels_of(draft)
    sigma = draft["record"]["channels"]["w_2"]["sigma"]
    assert sigma["low"] < 0.3 / 5 < 0.3 * 5 < sigma["high"]


def test_each_step_has_its_own_constant_voltage(tmp_path: Path) -> None:
    """The moment of each step, as a hand gives it, is its own as well."""
    rng = np.random.default_rng(2)
    paths = []
    for volts in (6.0, 9.5):
        t = 0.005 * np.arange(600)
        w = volts * (1 - np.exp(-t / 0.3)) + rng.normal(0, 0.05, 600)
        columns = {"t": t, "u [V]": np.full(600, volts), "w_2 [rad/s]": w}
        paths.append(write_table(tmp_path / f"step_{volts:g}V.csv", columns))
    draft = draft_of(paths)
    own = {name: entry["inputs"]["v"]["value"] for name, entry in draft["experiments"].items()}
    assert own == {"run_6V": 6, "run_9_5V": 9.5}
    assert draft["shared"] == ["sigma_w_2"]
    assert draft["inputs"]["t_0"] == {"prior": "uniform", "low": -0.005, "high": 0.005}
    assert "offset" not in draft["inputs"]["v"]


def test_files_of_channels_are_joined_to_their_files_of_inputs(tmp_path: Path) -> None:
    """The inputs have another clock, with another unit and twice as slow."""
    paths = []
    for name, columns in zip(
        ("slow", "fast"), split_rows(german_record(), 0, 900, 1600), strict=True
    ):
        v = {"t [s]": columns["Zeit_ms"][::2] / 1000, "U [V]": columns.pop("U_Motor")[::2]}
        paths += [
            write_table(tmp_path / f"{name}_v.csv", v),
            write_table(tmp_path / f"{name}.csv", columns),
        ]
    draft = draft_of([paths[1], paths[2], paths[3], paths[0]])
    assert draft["experiments"]["slow"] == {
        "record": {"file": "slow.csv"},
        "inputs": {"v": {"file": "slow_v.csv"}},
    }
    assert draft["experiments"]["fast"]["inputs"]["v"]["file"] == "fast_v.csv"
    assert draft["inputs"]["v"]["time"] == {"column": "t [s]", "unit": "s"}
    assert draft["inputs"]["t_0"]["high"] == 0.01  # a sample of the slower clock
    pair = draft_of(paths[:2])
    assert "experiments" not in pair
    assert pair["record"]["file"] == "slow.csv"
    assert pair["inputs"]["v"]["file"] == "slow_v.csv"


def test_files_of_one_signal_each_are_one_record(tmp_path: Path) -> None:
    """Named by file; one of them has a clock of its own."""
    t, v, x = reversing_rig()
    files = [tmp_path / n for n in ("theta_2_rad.mat", "omega_1_rad_s.csv", "voltage.mat")]
    scipy.io.savemat(files[0], {"data": np.stack([t, x[:, 1]], axis=-1)})
    write_table(files[1], {"t": t[::2], "value": x[::2, 2]})
    scipy.io.savemat(files[2], {"ans": np.stack([t, v])})  # as "To File" writes
    draft = draft_of(files, gear=5)
    channels = draft["record"]["channels"]
    assert {*channels} == {"theta_2", "w_1"}
    assert "experiments" not in draft
    names = {draft["record"]["file"], draft["inputs"]["v"]["file"]}
    names |= {entry["file"] for entry in channels.values() if "file" in entry}
    assert names == {file.name for file in files}


def test_files_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    columns = german_record()
    whole = write_table(tmp_path / "whole.csv", columns)

    def write_without(name: str, *heads: str) -> Path:
        kept = {head: x for head, x in columns.items() if head not in heads}
        return write_table(tmp_path / name, kept)

    lacks = write_without("lacks.csv", "n_Motor", "U_Motor")
    assert refusal([whole, lacks]) == (
        f"{lacks}: has no column n_Motor, U_Motor, but {whole} has. Several files must have the "
        "same columns, or complete each other at the same times. Otherwise write a config for each"
    )
    assert "is given twice" in refusal([whole, whole])
    v = {"Zeit_ms": columns["Zeit_ms"], "U_Motor": columns["U_Motor"]}
    supply = write_table(tmp_path / "supply.csv", v)
    assert "has no column" in refusal([whole, supply])
    later = write_table(tmp_path / "later.csv", {**v, "Zeit_ms": v["Zeit_ms"] + 9000})
    bare, again = (write_without(name, "U_Motor") for name in ("bare.csv", "again.csv"))
    assert "goes from 9 to 16.995 s" in refusal([bare, later])
    assert "Give one file of each kind for each record" in refusal([bare, again, supply])
    assert "no column is an angle" in refusal([supply, later])


def test_a_file_in_which_a_channel_stands_still_is_refused(tmp_path: Path) -> None:
    first, second = split_rows(german_record(), 0, 800, 1600)
    second["n_Rotor"] = np.full(800, 3.0)
    paths = [write_table(tmp_path / "a.csv", first), write_table(tmp_path / "b.csv", second)]
    assert refusal(paths) == f"{paths[1]}: column n_Rotor is 3 in every row. Leave this file out"


@run_cases(
    "names, labels",
    [
        (("slow", "square", "sweep"), ["slow", "square", "sweep"]),
        (("idf_pos_0.065_1", "idf_pos_0.065_2"), ["run_1", "run_2"]),
        (("a_06_x", "a_065_x"), ["run_06", "run_065"]),
        (("run", "run_2"), ["run", "run_2"]),
        (("one/rec", "two/rec"), ["one", "two"]),
        (("Größe 1-a", "Größe 1-b"), ["a", "b"]),
        (("a-b", "a.b"), ["run_1", "run_2"]),
    ],
)
def test_experiments_are_called_by_what_differs(names: tuple[str, ...], labels: list[str]) -> None:
    assert record_files.experiment_labels([Path(f"{name}.csv") for name in names]) == labels


def test_records_one_after_the_other_are_split(tmp_path: Path) -> None:
    """Each is an experiment of its rows; what is too short for a record is none."""
    draft = draft_of(write_table(tmp_path / "r.csv", repeated(300, 5, 400)), split=True)
    assert draft["experiments"] == {
        "run_1": {"record": {"file": "r.csv", "rows": [2, 301]}},
        "run_2": {"record": {"file": "r.csv", "rows": [307, 706]}},
    }
    first, second = map(reading.read, loading.load(tmp_path / "r.yaml").experiments)
    assert (len(first.t), len(second.t)) == (300, 400)
    np.testing.assert_allclose(second.y[:, 0] * 30 / np.pi, np.round(SPEED, 5))
    assert second.t[-1] == pytest.approx(T[-1])
    text = draft["text"].replace("rows: [307, 706]", "rows: [9000, 9999]")
    (tmp_path / "r.yaml").write_text(text)
    with pytest.raises(bd.InputError, match="has no rows from 9000 to 9999"):
        bd.load(tmp_path / "r.yaml")
