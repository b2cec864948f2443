"""First configs of several files, and of columns that came late, in turns, with glitches or moving."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from support import command_line
from support.case_tables import for_each
from support.first_configs import DEG, RPM, accepted, both_ways, german, made, told, written

import bayesdrill as bd
from bayesdrill.basics.errors import InputError
from bayesdrill.config.yaml_source import parse
from bayesdrill.drafting import record_files

Columns = dict[str, np.ndarray]


def config_of(records: list[Path], **known: Any) -> dict[str, Any]:
    """What is written for several files; it has to be valid."""
    target = records[0].with_name("together.yaml")
    bd.init(records, target, force=True, **known)
    accepted(target)
    return {**parse(target, target.read_text()).data, "text": target.read_text()}


def parts(columns: Columns, *edges: int) -> list[Columns]:
    """Rows from each edge to the next, with times from 0."""
    cut = [{name: x[a:b] for name, x in columns.items()} for a, b in itertools.pairwise(edges)]
    return [{name: x - x[0] if name == "Zeit_ms" else x for name, x in one.items()} for one in cut]


def test_files_of_one_kind_are_experiments_of_one_config(tmp_path: Path) -> None:
    """What is common stands once; the second begins in motion, the first at rest."""
    one, two = parts(german(), 0, 900, 1600)
    paths = [
        written(tmp_path / "test 2 fast.csv", one),
        written(tmp_path / "test 2 slow.csv", two),
    ]
    found = config_of(paths)
    assert told(found).keys() == {"theta_1", "w_1", "motor"}
    assert "file" not in found["record"]
    assert found["experiments"] == {
        "fast": {"record": {"file": "test 2 fast.csv"}},
        "slow": {"record": {"file": "test 2 slow.csv"}, "initial": "free"},
    }
    assert found["shared"] == ["t_0", "offset_v", "sigma_theta_1", "sigma_w_1", "sigma_motor"]
    assert bd.init(paths).path == tmp_path / "test_2.yaml"


def test_meanings_are_those_of_the_file_that_tells_most(tmp_path: Path) -> None:
    """The rotor hardly moves in the first, so that its unit cannot be told there.

    Mutant killed: the first file leads.
    """
    t, v, x = both_ways()
    rng = np.random.default_rng(3)

    def columns(share: float) -> Columns:
        return {
            "t [s]": t,
            "U": share * v,
            "phi": share * x[:, 0] * DEG + rng.normal(0, 0.3, len(t)),
            "speed": share * x[:, 2] * RPM + rng.normal(0, 0.3, len(t)),
        }

    paths = [written(tmp_path / f"{n}.csv", columns(s)) for n, s in (("a", 1e-5), ("b", 1.0))]
    alone = made(paths[0])
    found = config_of(paths)
    assert {unit for _, unit in told(found).values()} == {"deg", "rpm"}
    assert told(alone) != told(found)
    sigma = found["record"]["channels"]["w_2"]["sigma"]
    assert sigma["low"] < 0.3 / 5 < 0.3 * 5 < sigma["high"]


def test_constant_voltages_of_steps_are_each_its_own(tmp_path: Path) -> None:
    """And so is the moment of each step, as a hand gives it."""
    rng = np.random.default_rng(2)
    paths = []
    for volts in (6.0, 9.5):
        t = 0.005 * np.arange(600)
        w = volts * (1 - np.exp(-t / 0.3)) + rng.normal(0, 0.05, 600)
        columns = {"t": t, "u [V]": np.full(600, volts), "w_2 [rad/s]": w}
        paths.append(written(tmp_path / f"step_{volts:g}V.csv", columns))
    found = config_of(paths)
    own = {name: one["inputs"]["v"]["value"] for name, one in found["experiments"].items()}
    assert own == {"run_6V": 6, "run_9_5V": 9.5}
    assert found["shared"] == ["sigma_w_2"]
    assert found["inputs"]["t_0"] == {"prior": "uniform", "low": -0.005, "high": 0.005}
    assert "offset" not in found["inputs"]["v"]


def test_channels_and_inputs_in_files_of_their_own(tmp_path: Path) -> None:
    """Another clock, with another unit and twice as slow; each file of channels finds its inputs.

    Mutant killed: inputs are taken in the order in which they are named.
    """
    paths = []
    for name, columns in zip(("slow", "fast"), parts(german(), 0, 900, 1600), strict=True):
        t = columns["Zeit_ms"]
        v = {"t [s]": t[::2] / 1000, "U [V]": columns.pop("U_Motor")[::2]}
        paths += [
            written(tmp_path / f"{name}_v.csv", v),
            written(tmp_path / f"{name}.csv", columns),
        ]
    found = config_of([paths[1], paths[2], paths[3], paths[0]])
    assert found["experiments"]["slow"] == {
        "record": {"file": "slow.csv"},
        "inputs": {"v": {"file": "slow_v.csv"}},
    }
    assert found["experiments"]["fast"]["inputs"]["v"]["file"] == "fast_v.csv"
    assert found["inputs"]["v"]["time"] == {"column": "t [s]", "unit": "s"}
    assert found["inputs"]["t_0"]["high"] == 0.01  # a sample of the slower clock
    alone = config_of(paths[:2])
    assert "experiments" not in alone
    assert alone["record"]["file"] == "slow.csv"
    assert alone["inputs"]["v"]["file"] == "slow_v.csv"


def refused(records: list[Path]) -> str:
    with pytest.raises(InputError) as caught:
        bd.init(records, records[0].with_name("no.yaml"))
    return str(caught.value)


def test_files_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    columns = german()
    whole = written(tmp_path / "whole.csv", columns)
    lacks = written(
        tmp_path / "lacks.csv",
        {n: x for n, x in columns.items() if n not in ("n_Motor", "U_Motor")},
    )
    assert refused([whole, lacks]) == (
        f"{lacks}: has no column n_Motor, U_Motor, but {whole} has. Several files must have the "
        "same columns, or complete each other at the same times. Otherwise write a config for each"
    )
    assert "is given twice" in refused([whole, whole])
    v = {"Zeit_ms": columns["Zeit_ms"], "U_Motor": columns["U_Motor"]}
    supply = written(tmp_path / "supply.csv", v)
    assert "has no column" in refused([whole, supply])
    later = written(tmp_path / "later.csv", {**v, "Zeit_ms": v["Zeit_ms"] + 9000})
    others = {name: x for name, x in columns.items() if name != "U_Motor"}
    bare = written(tmp_path / "bare.csv", others)
    assert "goes from 9 to 16.995 s" in refused([bare, later])
    again = written(tmp_path / "again.csv", others)
    assert "Give one file of each kind for each record" in refused([bare, again, supply])
    assert "no column is an angle" in refused([supply, later])
    assert not (tmp_path / "no.yaml").exists()


# Names of files, and what tells them apart.
LABELS = {
    ("slow", "square", "sweep"): ["slow", "square", "sweep"],
    ("idf_pos_0.065_1", "idf_pos_0.065_2"): ["run_1", "run_2"],
    ("a_06_x", "a_065_x"): ["run_06", "run_065"],
    ("run", "run_2"): ["run", "run_2"],
    ("one/rec", "two/rec"): ["one", "two"],
    ("Größe 1-a", "Größe 1-b"): ["a", "b"],
    ("a-b", "a.b"): ["run_1", "run_2"],
}


def test_experiments_are_called_by_what_differs() -> None:
    def check(names: tuple[str, ...]) -> None:
        assert (
            record_files.experiment_labels([Path(f"{name}.csv") for name in names]) == LABELS[names]
        )

    for_each({str(names): (names,) for names in LABELS}, check)


def turned(t: np.ndarray, late: float, w: float) -> tuple[np.ndarray, np.ndarray]:
    """An angle at the gearbox, and the twist of a swinging rotor behind it, `late` s before."""

    def drive(s: np.ndarray) -> np.ndarray:
        return np.where(s > 0, 2.0 * np.sin(1.3 * s) ** 2 + 0.5 * np.sin(7.0 * s), 0.0)

    # q'' + w^2 q = -theta_2'', by its exact response on a fine grid
    h = 2e-4
    s = h * np.arange(int(t[-1] / h) + 2)
    push = -np.gradient(np.gradient(drive(s), h), h)
    step = scipy.linalg.expm(h * np.array([[0, 1, 0], [-(w**2), 0, 1], [0, 0, 0]]))
    q = np.zeros((len(s), 2))
    for k in range(len(s) - 1):
        q[k + 1] = step[:2, :2] @ q[k] + step[:2, 2] * push[k]
    return drive(t), np.interp(t - late, s, q[:, 0])


def test_a_late_twist_is_told_by_what_it_does_to_rotor_1(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Mutant killed: the shift has the wrong sign."""

    def check(late: float) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        t = 0.005 * np.arange(2000)
        rng = np.random.default_rng(4)
        angle, twist = turned(t, late, 12.0)
        columns = {
            "t [s]": t,
            "theta_2 [rad]": angle + rng.normal(0, 2e-4, len(t)),
            "twist [rad]": twist + rng.normal(0, 2e-4, len(t)),
        }
        found = made(written(tmp_path / "r.csv", columns), voltage=5.0)
        channels = found["record"]["channels"]
        assert "lag" not in channels["theta_2"]
        if late:
            assert channels["twist"]["lag"] == {
                "prior": "uniform",
                "low": 0,
                "high": pytest.approx(1e3 * (2 * late + 3 * 0.005), rel=0.15),
                "unit": "ms",
            }
            assert "it seems to be 15 ms late" in found["text"]
        else:
            assert "lag" not in channels["twist"]
            assert "#   lag: {prior: uniform, low: 0, high: 25, unit: ms}" in found["text"]

    for_each({str(late): (late,) for late in [0.0, 0.015]}, check)


def test_an_angle_that_begins_again_is_unwrapped(tmp_path_factory: pytest.TempPathFactory) -> None:
    def check(unit: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        columns = german()
        columns["n_Rotor [rpm]"] = columns.pop("n_Rotor")
        turns = 5 * columns.pop("phi_Rotor_deg")
        columns["n_Rotor [rpm]"] *= 5
        columns[f"phi_Rotor{unit}"] = np.mod(turns + 180, 360) - 180
        found = made(written(tmp_path / "r.csv", columns), gear=1)
        theta = found["record"]["channels"]["theta_1"]
        assert (theta["wraps"], theta["unit"]) == (360, "deg")
        told_of = " ".join(accepted(tmp_path / "r.yaml"))
        jumps = int(np.sum(np.abs(np.diff(columns[f"phi_Rotor{unit}"])) > 180))
        assert f"theta_1: unwrapped {jumps} jumps of 360 deg" in told_of
        assert jumps > 3

    for_each({unit: (unit,) for unit in [" [deg]", ""]}, check)


def test_uneven_times_tell_units_all_the_same(tmp_path: Path) -> None:
    columns = german()
    rng = np.random.default_rng(7)
    kept = np.sort(rng.choice(1600, 1200, replace=False))
    kept[0] = 0
    columns = {name: x[kept] for name, x in columns.items()}
    found = made(written(tmp_path / "r.csv", columns))
    assert told(found)["w_1"] == ("n_Rotor", "rpm")
    assert found["record"]["channels"]["motor"]["measures"] == "5 * w_2"
    assert "window" not in found["record"]
    assert "nothing is resampled" in found["text"].replace("\n  # ", " ")


def test_how_a_start_is_said(tmp_path: Path) -> None:
    """Steady until the voltage changes; at rest elsewhere than at zero; turning, by an angle alone."""
    t = 0.005 * np.arange(1200)
    rng = np.random.default_rng(8)
    v = np.where(t < 2, 4.0, 7.0)
    late = np.maximum(t - 2, 0)
    w = 20 + 15 * (1 - np.exp(-late / 0.3))
    theta = 20 * t + 15 * (late - 0.3 * (1 - np.exp(-late / 0.3)))
    noisy = theta[:, None] + rng.normal(0, 0.01, (len(t), 1))
    columns = {"t": t, "u": v, "theta_2": 3 + noisy[:, 0], "w_2": w + rng.normal(0, 0.2, len(t))}
    found = made(written(tmp_path / "a.csv", columns))
    assert found["initial"] == {"state": "steady", "theta_2": "free"}
    accepted(tmp_path / "a.yaml")
    del columns["w_2"]
    found = made(written(tmp_path / "b.csv", {**columns, "u": v + 0.3 * np.sin(9 * t)}))
    assert found["initial"] == "free"
    rest = {"t": t, "u": v - 4, "theta_2": 3 + noisy[:, 0] - 20 * t}
    found = made(written(tmp_path / "c.csv", rest))
    assert "initial" not in found
    offset = found["record"]["channels"]["theta_2"]["offset"]
    assert (offset["mean"], offset["sd"]) == (0, pytest.approx(6.0, rel=0.05))
    accepted(tmp_path / "c.yaml")


def test_one_file_for_several_at_the_command_line(tmp_path: Path) -> None:
    columns = german()
    paths = [written(tmp_path / f"{n}.csv", columns) for n in ("first", "second")]
    done = command_line.cli("init", *paths, "--output", tmp_path / "both.yaml")
    assert done.status == 0
    assert "experiments first, second; channels theta_1, w_1, motor" in done.out
    assert command_line.cli("init", *paths, "--output", paths[1], "--force").status == 2
    assert paths[1].read_text() == paths[0].read_text()


def test_a_file_in_which_a_channel_stands_still_is_refused(tmp_path: Path) -> None:
    """As `check` would refuse it."""
    one, two = parts(german(), 0, 800, 1600)
    two["n_Rotor"] = np.full(800, 3.0)
    paths = [written(tmp_path / "a.csv", one), written(tmp_path / "b.csv", two)]
    assert refused(paths) == f"{paths[1]}: column n_Rotor is 3 in every row. Leave this file out"
