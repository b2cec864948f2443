"""Real records of rigs that no voltage drives, by the configs of the documents; SciPy alone beside them.

The records do not come with the project: where they are not, nothing is tested.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from documents import DOCS, ROOT, files
from scipy.io import loadmat
from scipy.linalg import expm
from scipy.optimize import least_squares

import bayesdrill as bd
from bayesdrill.record.experiment import Experiment, frozen
from bayesdrill.setup import loading, reading
from bayesdrill.setup.job import Job, prepare

SHARED = ROOT.parent / "shared" / "data"
STRING = SHARED / "ufrj_drillstring_rig" / "175_completo_1.mat"
SERVO = SHARED / "hsm150_servo"
drill = pytest.mark.skipif(
    not STRING.exists(), reason="a record that does not come with the project"
)
servo = pytest.mark.skipif(not SERVO.is_dir(), reason="records that do not come with the project")

RPM = 2 * np.pi / 60
QUICK = "\nsampler: {ess: 1000}\noutput: {figures: [], predictive_draws: 10}\n"


def config(folder: Path, name: str, *changes: tuple[str, str]) -> Path:
    """As the documents have it, in a folder with links to its records."""
    text = files(DOCS / "rigs.md")[name] + QUICK
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    for record in (STRING, *SERVO.glob("*.mat")):
        if not (folder / record.name).exists():
            (folder / record.name).symlink_to(record)
    (folder / name).write_text(text)
    return folder / name


# --- a drill string that sticks and slips ----------------------------------------------------------


def recorded(begin: float, end: float) -> dict[str, np.ndarray]:
    """Columns in SI, read by SciPy; the torque of the whole record."""
    every = loadmat(STRING)
    found = {
        name.partition("_Sample")[0]: x.ravel() for name, x in every.items() if "Sample" in name
    }
    t = found["Time"]
    rows = (t > begin - 1e-6) & (t < end + 1e-6)
    return {
        "t": t[rows], "top": found["Top_Speed"][rows] * RPM, "bit": found["Bit_Speed"][rows] * RPM,
        "all_t": t, "torque": found["Bit_Torque"],
    }  # fmt: skip


def course(p: np.ndarray, of: dict[str, np.ndarray]) -> np.ndarray:
    """The bit's speed at parameters k_s, j_1, c_s, lag, twist and speed at the start.

    twist' = w_2 - w_1, j_1 w_1' = k_s twist + c_s (w_2 - w_1) - torque: inputs straight between samples.
    """
    k_s, j_1, c_s, lag, twist, w_1 = p
    top, torque = of["top"], np.interp(of["t"] - lag, of["all_t"], of["torque"])
    block = np.zeros((6, 6))
    block[:2, :2] = [[0.0, -1.0], [k_s / j_1, -c_s / j_1]]
    block[:2, 2:4] = [[1.0, 0.0], [c_s / j_1, -1.0 / j_1]]
    block[2:4, 4:] = np.eye(2)
    dt = float(np.mean(np.diff(of["t"])))
    step = expm(block * dt)
    u = np.column_stack([top, torque])
    pushed = u[:-1] @ step[:2, 2:4].T + np.diff(u, axis=0) @ (step[:2, 4:] / dt).T
    x, found = np.array([twist, w_1]), [w_1]
    for push in pushed:
        x = step[:2, :2] @ x + push
        found.append(x[1])
    return np.array(found)


def share(left: np.ndarray, y: np.ndarray) -> float:
    return float(np.sqrt(np.mean(left**2)) / y.std())


@drill
def test_a_drill_string_is_found_as_least_squares_find_it(tmp_path: Path) -> None:
    """At every sample, against equations, exponential and search of SciPy; what is left is at most 3.2 %
    of the bit's speed.
    """
    job = prepare(
        config(tmp_path, "drill_string.yaml", ("  decimate: {factor: 20}", "  missing: drop"))
    )
    best = bd.Case(job).find_map().values
    of = recorded(37.0, 41.0)
    known = (of["t"] > 37.1 - 1e-6) & (of["t"] < 40.9 + 1e-6)  # whatever the lag is
    scale = np.array([4.0, 8e-3, 0.02, 0.03, 1.0, 5.0])

    def left(z: np.ndarray) -> np.ndarray:
        return (course(z * scale, of) - of["bit"])[known]

    fitted = least_squares(left, [1.0, 1.0, 1.0, -1.0, 0.5, 1.0], x_scale="jac")
    k_s, j_1, c_s, lag, twist, w_1 = fitted.x * scale
    assert best["k_s"] == pytest.approx(k_s, rel=1e-4)
    assert best["j_1"] == pytest.approx(j_1, rel=1e-4)
    assert best["c_s"] == pytest.approx(c_s, rel=1e-3)
    assert best["lag_t_1"] == pytest.approx(lag, abs=2e-6)
    assert best["theta_1_0"] == pytest.approx(-twist, abs=1e-4)
    assert best["w_1_0"] == pytest.approx(w_1, rel=1e-3)
    assert best["sigma_w_1"] == pytest.approx(np.sqrt(np.mean(fitted.fun**2)), rel=1e-3)
    assert share(fitted.fun, of["bit"][known]) < 0.032
    assert 4.0 < best["k_s"] < 4.25
    assert 7.6e-3 < best["j_1"] < 8.0e-3
    assert -0.035 < best["lag_t_1"] < -0.025
