"""A measured record of a drill string, against least squares of SciPy; `benchmarks/real` has others.

The record does not come with the project: where it is absent, these tests are skipped.
"""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.signal import lfilter
from support.document_blocks import DOCS, ROOT, files

import bayesdrill as bd

SHARED = ROOT.parent / "shared" / "data"
STRING = SHARED / "ufrj_drillstring_rig" / "175_completo_1.mat"

RPM, DT = 2 * np.pi / 60, 1e-3
QUICK = """
map: {starts: 2, evaluations: 500}
sampler: {ess: 1000}
output: {figures: [], predictive_draws: 10}
"""


def recorded(begin: float, end: float) -> dict[str, np.ndarray]:
    """Return columns in SI, read by SciPy; times and torque of the whole record too."""
    mat = loadmat(STRING)
    table = {name.partition("_Sample")[0]: x.ravel() for name, x in mat.items() if "Sample" in name}
    t = table["Time"]
    rows = (t > begin - 1e-6) & (t < end + 1e-6)
    return {
        "t": t[rows], "top": table["Top_Speed"][rows] * RPM, "bit": table["Bit_Speed"][rows] * RPM,
        "all_t": t, "torque": table["Bit_Torque"],
    }  # fmt: skip


def bit_speed(p: np.ndarray, record: dict[str, np.ndarray]) -> np.ndarray:
    """Return the speed at parameters k_s, j_1, c_s, lag, and twist and speed at the start.

    twist' = w_2 - w_1, j_1 w_1' = k_s twist + c_s (w_2 - w_1) - torque; inputs are piecewise linear.
    """
    k_s, j_1, c_s, lag, twist, w_1 = p
    block = np.zeros((6, 6))
    block[:2, :2] = [[0.0, -1.0], [k_s / j_1, -c_s / j_1]]
    block[:2, 2:4] = [[1.0, 0.0], [c_s / j_1, -1.0 / j_1]]
    block[2:4, 4:] = np.eye(2)
    step = expm(block * DT)
    torque = np.interp(record["t"] - lag, record["all_t"], record["torque"])
    u = np.column_stack([record["top"], torque])
    pushed = u[:-1] @ step[:2, 2:4].T + np.diff(u, axis=0) @ (step[:2, 4:] / DT).T
    # x+ = S x + push, mode by mode.
    roots, modes = np.linalg.eig(step[:2, :2])
    inputs = np.linalg.solve(modes, np.vstack([[twist, w_1], pushed]).T)
    x = [lfilter([1.0], [1.0, -root], mode) for root, mode in zip(roots, inputs, strict=True)]
    return np.real(modes @ np.array(x))[1]


def unexplained(residuals: np.ndarray, y: np.ndarray) -> float:
    """Return the rms residual relative to the standard deviation of the record."""
    return float(np.sqrt(np.mean(residuals**2)) / y.std())


@pytest.mark.skipif(not STRING.exists(), reason="a record that does not come with the project")
def test_a_drill_string_is_identified_as_by_least_squares(tmp_path: Path) -> None:
    """At every sample; at most 3.2 % of the bit's speed is unexplained."""
    text = files(DOCS / "rigs.md")["drill_string.yaml"] + QUICK
    path = tmp_path / "drill_string.yaml"
    path.write_text(text.replace("  decimate: {factor: 20}", "  missing: drop"))
    (tmp_path / STRING.name).symlink_to(STRING)
    best = bd.load(path).find_map().values
    record = recorded(37.0, 41.0)
    known = (record["t"] > 37.1 - 1e-6) & (record["t"] < 40.9 + 1e-6)  # whatever the lag is
    scale = np.array([4.0, 8e-3, 0.02, 0.03, 1.0, 5.0])

    def residuals(z: np.ndarray) -> np.ndarray:
        return (bit_speed(z * scale, record) - record["bit"])[known]

    fitted = least_squares(residuals, [1.0, 1.0, 1.0, -1.0, 0.5, 1.0], x_scale="jac")
    k_s, j_1, c_s, lag, twist, w_1 = fitted.x * scale
    assert best["k_s"] == pytest.approx(k_s, rel=1e-4)
    assert best["j_1"] == pytest.approx(j_1, rel=1e-4)
    assert best["c_s"] == pytest.approx(c_s, rel=1e-3)
    assert best["lag_t_1"] == pytest.approx(lag, abs=2e-6)
    assert best["theta_1_0"] == pytest.approx(-twist, abs=1e-4)
    assert best["w_1_0"] == pytest.approx(w_1, rel=1e-3)
    assert best["sigma_w_1"] == pytest.approx(np.sqrt(np.mean(fitted.fun**2)), rel=1e-3)
    assert unexplained(fitted.fun, record["bit"][known]) < 0.032
    assert 4.0 < best["k_s"] < 4.25
    assert 7.6e-3 < best["j_1"] < 8.0e-3
    assert -0.035 < best["lag_t_1"] < -0.025
