"""Real records of rigs that no voltage drives, by the configs of the documents; SciPy alone beside them.

The records do not come with the project: where they are not, nothing is tested.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.signal import lfilter
from support import command_line
from support.document_blocks import DOCS, ROOT, files

import bayesdrill as bd
from bayesdrill.analysis.comparison import repeats
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.config.job import prepare

SHARED = ROOT.parent / "shared" / "data"
STRING = SHARED / "ufrj_drillstring_rig" / "175_completo_1.mat"
SERVO = SHARED / "hsm150_servo"
SIMULATED = SHARED / "simulated_servo"
drill = pytest.mark.skipif(
    not STRING.exists(), reason="a record that does not come with the project"
)
simulated = pytest.mark.skipif(
    not SIMULATED.is_dir(), reason="records that do not come with the project"
)
servo = pytest.mark.skipif(not SERVO.is_dir(), reason="records that do not come with the project")

RPM, DT = 2 * np.pi / 60, 1e-3
QUICK = """
map: {starts: 2, evaluations: 500}
sampler: {ess: 1000}
output: {figures: [], predictive_draws: 10}
"""
WHOLE = ("  decimate: {factor: 20}", "  missing: drop")  # every sample


def config(folder: Path, name: str, *changes: tuple[str, str]) -> Path:
    """As the documents have it, in a folder with links to its records."""
    text = files(DOCS / "rigs.md")[name] + QUICK
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    for record in (STRING, *SERVO.glob("*.mat"), *SIMULATED.glob("*.csv")):
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
    block = np.zeros((6, 6))
    block[:2, :2] = [[0.0, -1.0], [k_s / j_1, -c_s / j_1]]
    block[:2, 2:4] = [[1.0, 0.0], [c_s / j_1, -1.0 / j_1]]
    block[2:4, 4:] = np.eye(2)
    step = expm(block * DT)
    u = np.column_stack([of["top"], np.interp(of["t"] - lag, of["all_t"], of["torque"])])
    pushed = u[:-1] @ step[:2, 2:4].T + np.diff(u, axis=0) @ (step[:2, 4:] / DT).T
    # x+ = S x + push, mode by mode.
    roots, modes = np.linalg.eig(step[:2, :2])
    every = np.linalg.solve(modes, np.vstack([[twist, w_1], pushed]).T)
    found = [lfilter([1.0], [1.0, -root], mode) for root, mode in zip(roots, every, strict=True)]
    return np.real(modes @ np.array(found))[1]


def share(left: np.ndarray, y: np.ndarray) -> float:
    return float(np.sqrt(np.mean(left**2)) / y.std())


@drill
def test_a_drill_string_is_found_as_least_squares_find_it(tmp_path: Path) -> None:
    """At every sample, against equations, exponential and search of SciPy; what is left is at most 3.2 %
    of the bit's speed.
    """
    job = prepare(config(tmp_path, "drill_string.yaml", WHOLE))
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


LAG = ",\n        lag: {prior: uniform, low: -100, high: 100, unit: ms}}"


@pytest.mark.slow
@drill
def test_what_a_drill_string_did_foretells_what_it_does(tmp_path: Path) -> None:
    """Its posterior of 37 to 41 s on 44 to 48 s: of half a second only the start is taken there."""
    case = bd.load(config(tmp_path, "drill_string.yaml"))
    run = case.sample(seed=1)
    assert run.converged
    draws = {name: run.draws[name].ravel() for name in ("k_s", "j_1", "c_s", "lag_t_1")}
    limits = {"k_s": (4.0, 4.25), "j_1": (7.6e-3, 8.0e-3), "lag_t_1": (-0.035, -0.025)}
    for name, (low, high) in limits.items():
        least, most = np.quantile(draws[name], [0.03, 0.97])
        assert low < least < most < high, name
    then = ("window: [37, 41]", "window: [43.9, 48]")
    later = prepare(config(tmp_path, "drill_string.yaml", then, WHOLE))
    one = later.problem.observations[0].response
    y, t = one.experiment.y[:, 0], one.experiment.t
    begin, rest = (t > 44.0) & (t < 44.5), (t > 44.5) & (t < 47.9)
    found = []
    for k in np.linspace(0, len(draws["k_s"]) - 1, 30).astype(int):
        own = [draws[name][k] if name in draws else 0.0 for name in one.parameters]
        starts = [[1.0 * (name == of) for name in one.parameters] for of in ("theta_1_0", "w_1_0")]
        plain, *each = one.signals(np.array([own, *(np.add(own, start) for start in starts)]))[
            ..., 0
        ]
        bases = np.array(each).T - plain[:, None]
        best = np.linalg.lstsq(bases[begin], (y - plain)[begin])[0]
        found.append(plain + bases @ best)
    assert share(np.mean(found, axis=0)[rest] - y[rest], y[rest]) < 0.06


@pytest.mark.slow
@drill
def test_a_torque_taken_as_if_it_were_in_time_is_named(tmp_path: Path) -> None:
    """Without its lag a third of the bit's speed is left, and the report says which would explain it."""
    path = config(tmp_path, "drill_string.yaml", (LAG, "}"))
    ran = command_line.cli("map", path, "--output", tmp_path / "out", "--processes", "1")
    assert "fit: the MAP leaves unexplained 33 % of w_1." in ran.out
    assert "the residuals are correlated from one sample to the next: w_1" in ran.out
    assert "fit: A is the config with a lag of w_1" in ran.out
    assert "lag: {prior: uniform, low: -0.1, high: 0.1}" in ran.out


# --- a servo, step of its torque by step -----------------------------------------------------------

REPEATS = ("first", "second", "third")


def stepped(which: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, torque and speed of a repeat, read by SciPy."""
    data = loadmat(SERVO / f"idf_pos_0.065_{which}.mat")["data"]
    rows = (data[:, 0] > 8.0 - 1e-6) & (data[:, 0] < 14.0 + 1e-6)
    return data[rows, 0], data[rows, 4], data[rows, 3]


def one_by_one() -> dict[str, np.ndarray]:
    """Of each repeat j_m, c_m and t_f by least squares: steady, then an exponential to another speed."""
    found = []
    for which in (1, 2, 3):
        t, torque, w = stepped(which)
        at = t[np.argmax(torque > torque[0])]
        scale = np.array([1.4e-4, 9e-5, 0.037])

        def left(z: np.ndarray, t=t, torque=torque, w=w, at=at, scale=scale) -> np.ndarray:
            j_m, c_m, t_f = z * scale
            before, after = (torque[0] - t_f) / c_m, (torque[-1] - t_f) / c_m
            risen = 1 - np.exp(-c_m / j_m * np.clip(t - at, 0, None))
            return before + (after - before) * risen - w

        found.append(least_squares(left, np.ones(3), x_scale="jac").x * scale)
    return dict(zip(("j_m", "c_m", "t_f"), np.array(found).T, strict=True))


@pytest.mark.slow
@servo
def test_each_repeat_of_a_servo_is_found_as_least_squares_find_it(tmp_path: Path) -> None:
    """Inertia, damping and friction of three steps of the torque, each with its own, at every sample."""
    best = bd.load(config(tmp_path, "servo_repeats.yaml", WHOLE)).find_map().values
    for name, exact in one_by_one().items():
        found = [best[f"{name}_{label}"] for label in REPEATS]
        assert found == pytest.approx(exact, rel=1e-4), name
    assert min(best[f"j_m_{label}"] for label in REPEATS) > 1.3e-4


@pytest.mark.slow
@servo
def test_repeats_of_a_servo_differ_as_they_do_one_by_one(tmp_path: Path) -> None:
    """With one inertia, damping and friction for all, how far each repeat puts them from there is what
    the fits of single repeats say, and that friction differs is no chance.
    """
    path = config(tmp_path, "servo_repeats.yaml", ("own: [j_m, c_m, t_f]", ""), WHOLE)
    job = prepare(path)
    problem = job.problem
    best = bd.Case(job).find_map().values
    theta = problem.posterior.space.vector(best)
    products = [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
    found = repeats(SensitivityStudy(problem.posterior.likelihood), theta, products)
    for one, (name, exact) in zip(found, one_by_one().items(), strict=True):
        assert one.labels == REPEATS
        logs = np.log(exact / best[name])
        logs -= np.average(logs, weights=1 / np.array(one.sds) ** 2)
        assert one.apart == pytest.approx(logs, abs=0.1 * np.ptp(logs)), name
    _, c_m, t_f = found
    assert t_f.differs
    assert c_m.differs
    assert 0.002 < t_f.spread < 0.02


# --- a servo that rubs at both ends, of which the truth is known -----------------------------------

TRUTH = {
    "j_m": 4.5e-6, "c_m": 2e-6, "k_e": 0.02, "r_m": 1.8, "l_m": 0.6e-3, "k_s": 0.9, "j_1": 2.4e-3,
    "c_s": 8e-4, "t_cm": 2.5e-3, "t_c1": 0.006, "t_s1": 0.012, "w_s1": 0.3,
    "lag_alpha": 3.3e-3, "offset_v": -0.06,
}  # fmt: skip
PRODUCTS = {  # what the scale of the motor's constant and current leaves: exponents
    "k_s/j_1": {"k_s": 1, "j_1": -1},
    "c_s/j_1": {"c_s": 1, "j_1": -1},
    "t_c1/j_1": {"t_c1": 1, "j_1": -1},
    "t_s1/j_1": {"t_s1": 1, "j_1": -1},
    "t_cm/j_1": {"t_cm": 1, "j_1": -1},
    "j_m/j_1": {"j_m": 1, "j_1": -1},
    "c_m/j_1": {"c_m": 1, "j_1": -1},
    "t_cm r_m/k_T": {"t_cm": 1, "r_m": 1, "k_e": -1},
    "j_1 r_m/k_T": {"j_1": 1, "r_m": 1, "k_e": -1},
    "l_m/r_m": {"l_m": 1, "r_m": -1},
    **{name: {name: 1} for name in ("k_e", "w_s1", "lag_alpha", "offset_v")},
}


@pytest.mark.slow
@simulated
def test_three_records_of_a_servo_tell_all_that_its_symmetry_leaves(tmp_path: Path) -> None:
    """Friction at both ends, a damped shaft, an offset of the supply, a late sensor, all unknown."""
    run = bd.load(config(tmp_path, "three_records.yaml")).sample(seed=1)
    assert run.converged
    assert len(run.draws) >= 14
    draws = {name: run.draws[name].ravel() for name in TRUTH}
    for name, exponents in PRODUCTS.items():
        found = np.prod([draws[of] ** e for of, e in exponents.items()], axis=0)
        true = np.prod([TRUTH[of] ** e for of, e in exponents.items()])
        low, high = np.quantile(found, [0.005, 0.995])
        assert low <= true <= high, name
        near = {"k_s/j_1": 0.01, "t_cm r_m/k_T": 0.03}.get(name, np.inf)
        assert np.abs(np.array([low, high]) / true - 1).max() < near, name
    assert np.abs(draws["offset_v"] + 0.06).max() < 0.01
    assert np.abs(draws["lag_alpha"] - 3.3e-3).max() < 0.3e-3
