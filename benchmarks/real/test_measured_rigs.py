"""Records of a drill string and of servos, measured or simulated by other code, against known values.

The records do not come with the project: where they are absent, these tests are skipped.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.signal import lfilter
from support.case_tables import run_cases
from support.command_line import cli
from support.document_blocks import DOCS, ROOT, files
from support.unexplained_records import causes_of

import bayesdrill as bd
from bayesdrill.analysis.comparison import repeats
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.identifiability.torque_confounding import scaled_with_torque
from bayesdrill.analysis.latent_torque import regress_torque, torque_estimates
from bayesdrill.basics import seeds
from bayesdrill.config.job import prepare
from bayesdrill.report.sections.torque import stand_ins
from benchmarks.rates.records import points_near

SHARED = ROOT.parent / "shared" / "data"
STRING = SHARED / "ufrj_drillstring_rig" / "175_completo_1.mat"
SERVO = SHARED / "hsm150_servo"
SIMULATED = SHARED / "simulated_servo"
ABSENT = "a record that does not come with the project"
drill = pytest.mark.skipif(not STRING.exists(), reason=ABSENT)
servo = pytest.mark.skipif(not SERVO.is_dir(), reason=ABSENT)
simulated = pytest.mark.skipif(not SIMULATED.is_dir(), reason=ABSENT)

QUICK = """
map: {starts: 2, evaluations: 500}
sampler: {ess: 1000}
output: {figures: [], predictive_draws: 10}
"""
WHOLE = ("  decimate: {factor: 20}", "  missing: drop")  # every sample


def changed(text: str, *changes: tuple[str, str]) -> str:
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return text


def config(folder: Path, name: str, *changes: tuple[str, str]) -> Path:
    """Write a config of `docs/rigs.md`, with links to its records."""
    text = changed(files(DOCS / "rigs.md")[name] + QUICK, *changes)
    for record in (STRING, *SERVO.glob("*.mat"), *SIMULATED.glob("*.csv")):
        if not (folder / record.name).exists():
            (folder / record.name).symlink_to(record)
    (folder / name).write_text(text)
    return folder / name


def unexplained(residuals: np.ndarray, y: np.ndarray) -> float:
    """Return the rms residual relative to the standard deviation of the record."""
    return float(np.sqrt(np.mean(residuals**2)) / y.std())


# --- a drill string that sticks and slips ----------------------------------------------------------

RPM, DT = 2 * np.pi / 60, 1e-3


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


@pytest.mark.slow
@drill
def test_a_drill_string_is_identified_as_by_least_squares(tmp_path: Path) -> None:
    """At every sample; at most 3.2 % of the bit's speed is unexplained."""
    best = bd.load(config(tmp_path, "drill_string.yaml", WHOLE)).find_map().values
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


LAG = ",\n        lag: {prior: uniform, low: -100, high: 100, unit: ms}}"


@pytest.mark.slow
@drill
def test_the_posterior_of_a_drill_string_predicts_its_later_motion(tmp_path: Path) -> None:
    """From 37 to 41 s to 44 to 48 s, where half a second gives the initial state."""
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
    rig = later.problem.observations[0].response
    y, t = rig.experiment.y[:, 0], rig.experiment.t
    begin, rest = (t > 44.0) & (t < 44.5), (t > 44.5) & (t < 47.9)
    starts = [
        [1.0 * (name == start) for name in rig.parameters] for start in ("theta_1_0", "w_1_0")
    ]
    predictions = []
    for k in np.linspace(0, len(draws["k_s"]) - 1, 30).astype(int):
        own = [draws[name][k] if name in draws else 0.0 for name in rig.parameters]
        theta = np.array([own, *(np.add(own, start) for start in starts)])
        plain, *moved = rig.signals(theta)[..., 0]
        bases = np.array(moved).T - plain[:, None]
        best = np.linalg.lstsq(bases[begin], (y - plain)[begin])[0]
        predictions.append(plain + bases @ best)
    assert unexplained(np.mean(predictions, axis=0)[rest] - y[rest], y[rest]) < 0.06


@pytest.mark.slow
@drill
def test_a_missing_lag_of_a_torque_is_named(tmp_path: Path) -> None:
    """Without it a third of the bit's speed is unexplained."""
    path = config(tmp_path, "drill_string.yaml", (LAG, "}"))
    result = cli("map", path, "--output", tmp_path / "out", "--processes", "1")
    assert "fit: the MAP leaves unexplained 33 % of w_1." in result.out
    assert "the residuals are correlated from one sample to the next: w_1" in result.out
    assert "fit: A is the config with a lag of w_1" in result.out
    assert "lag: {prior: uniform, low: -0.1, high: 0.1}" in result.out


DRILLS = """
name: string
seed: 7
record:
  file: FILE
  time: {column: Time_Sample_175_complete, unit: s}
  window: [37, 41]
  decimate: {factor: 10}
  channels:
    w_1: {column: Bit_Speed_Sample_175_complete, unit: rpm,
          sigma: {prior: log_uniform, low: 0.01, high: 100}}
inputs:
  w_2: {column: Top_Speed_Sample_175_complete, unit: rpm, hold: first}
initial:
  w_1: {prior: normal, mean: 0, sd: 100, unit: rpm}
  theta_1: {prior: normal, mean: 0, sd: 3}
model: {name: driven_shaft}
missing_torque:
  at: rotor_1
  size: {prior: log_uniform, low: 0.01, high: 100}
  time: {prior: log_uniform, low: 0.005, high: 10}
parameters: {k_s: 4.11, j_1: 7.8e-3, c_s: 0.0149}
map: {starts: 1, evaluations: 500}
"""


def drilling(folder: Path, *changes: tuple[str, str]) -> bd.Case:
    (folder / "string.yaml").write_text(changed(DRILLS, ("FILE", str(STRING)), *changes))
    return bd.load(folder / "string.yaml")


@drill
@pytest.mark.slow
def test_the_torque_at_a_bit_is_that_of_a_load_cell_which_the_fit_never_sees(
    tmp_path: Path,
) -> None:
    """From speeds alone, with the spring, damping and inertia of the fit with that torque.

    The estimate has an unknown constant, as the twist at the start is unknown.
    """
    case = drilling(tmp_path)
    posterior = case.job.problem.posterior
    mode = posterior.space.vector(case.find_map(processes=1).mode.values)
    (estimate,) = torque_estimates(posterior, mode[None], seeds.stream(7, "torque"))
    mat = loadmat(STRING)
    names = ("Time_Sample_175_complete", "Bit_Torque_Sample_175_complete")
    t, torque = (mat[name].ravel() for name in names)
    inside = (estimate.t > 37.3) & (estimate.t < 40.7)
    estimated = -estimate.expected[inside]
    lags = np.arange(0.0, 0.06, 0.001)
    shifted = [np.interp(estimate.t[inside] + lag, t, torque) for lag in lags]
    correlations = [np.corrcoef(estimated, measured)[0, 1] for measured in shifted]
    best = int(np.argmax(correlations))
    assert 0.025 <= lags[best] <= 0.035
    assert correlations[best] > 0.98
    assert np.polyfit(shifted[best], estimated, 1)[0] == pytest.approx(1.0, abs=0.05)


@drill
@pytest.mark.slow
def test_a_free_spring_and_a_missing_torque_cannot_be_distinguished(tmp_path: Path) -> None:
    prior = "{prior: log_normal, median: 0.1, sd_log: 2}"
    free = ("k_s: 4.11, j_1: 7.8e-3, c_s: 0.0149", f"k_s: {prior}, j_1: {prior}")
    case = drilling(tmp_path, free)
    study = case.identify().study
    assert study.scaled == (("k_s", "j_1", "s_d"),)
    symmetries = study.structure.symmetries
    assert scaled_with_torque(case.job.problem.posterior, symmetries) == study.scaled
    sentences = stand_ins(study, case.job.problem.model)
    assert "k_s and j_1 and s_d can be changed together" in sentences
    assert "Hold one of k_s and j_1" in sentences


# --- a servo, step of its torque by step -----------------------------------------------------------

REPEATS = ("first", "second", "third")


def stepped(which: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, torque and speed of a repeat, read by SciPy."""
    data = loadmat(SERVO / f"idf_pos_0.065_{which}.mat")["data"]
    rows = (data[:, 0] > 8.0 - 1e-6) & (data[:, 0] < 14.0 + 1e-6)
    return data[rows, 0], data[rows, 4], data[rows, 3]


def fits_of_single_repeats() -> dict[str, np.ndarray]:
    """Return j_m, c_m and t_f of each repeat by least squares: an exponential between two speeds."""
    fits = []
    for which in (1, 2, 3):
        t, torque, w = stepped(which)
        at = t[np.argmax(torque > torque[0])]
        scale = np.array([1.4e-4, 9e-5, 0.037])

        def residuals(z: np.ndarray, t=t, torque=torque, w=w, at=at, scale=scale) -> np.ndarray:
            j_m, c_m, t_f = z * scale
            before, after = (torque[0] - t_f) / c_m, (torque[-1] - t_f) / c_m
            risen = 1 - np.exp(-c_m / j_m * np.clip(t - at, 0, None))
            return before + (after - before) * risen - w

        fits.append(least_squares(residuals, np.ones(3), x_scale="jac").x * scale)
    return dict(zip(("j_m", "c_m", "t_f"), np.array(fits).T, strict=True))


@pytest.mark.slow
@servo
def test_each_repeat_of_a_servo_is_identified_as_by_least_squares(tmp_path: Path) -> None:
    """Each of three steps of the torque with its own inertia, damping and friction, at every sample."""
    best = bd.load(config(tmp_path, "servo_repeats.yaml", WHOLE)).find_map().values
    for name, exact in fits_of_single_repeats().items():
        values = [best[f"{name}_{label}"] for label in REPEATS]
        assert values == pytest.approx(exact, rel=1e-4), name
    assert min(best[f"j_m_{label}"] for label in REPEATS) > 1.3e-4


@pytest.mark.slow
@servo
def test_repeats_of_a_servo_differ_as_their_single_fits_do(tmp_path: Path) -> None:
    """Shifts from a joint fit equal those of single fits, and those of friction are significant."""
    path = config(tmp_path, "servo_repeats.yaml", ("own: [j_m, c_m, t_f]", ""), WHOLE)
    job = prepare(path)
    problem = job.problem
    best = bd.Case(job).find_map().values
    theta = problem.posterior.space.vector(best)
    products = [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
    shifts = repeats(SensitivityStudy(problem.posterior.likelihood), theta, products)
    for shift, (name, exact) in zip(shifts, fits_of_single_repeats().items(), strict=True):
        assert shift.labels == REPEATS
        logs = np.log(exact / best[name])
        logs -= np.average(logs, weights=1 / np.array(shift.sds) ** 2)
        assert shift.apart == pytest.approx(logs, abs=0.1 * np.ptp(logs)), name
    _, c_m, t_f = shifts
    assert t_f.differs
    assert c_m.differs
    assert 0.002 < t_f.spread < 0.02


# --- a simulated servo with friction at both ends, of which the truth is known --------------------

TRUTH = {
    "j_m": 4.5e-6, "c_m": 2e-6, "k_e": 0.02, "r_m": 1.8, "l_m": 0.6e-3, "k_s": 0.9, "j_1": 2.4e-3,
    "c_s": 8e-4, "t_cm": 2.5e-3, "t_c1": 0.006, "t_s1": 0.012, "w_s1": 0.3,
    "lag_alpha": 3.3e-3, "offset_v": -0.06,
}  # fmt: skip
PRODUCTS = {  # exponents of products that the scale of the motor's constant leaves unchanged
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
def test_three_records_of_a_servo_determine_all_products_but_for_its_symmetry(
    tmp_path: Path,
) -> None:
    """Friction at both ends, a damped shaft, an offset of the supply, a late sensor, all unknown."""
    run = bd.load(config(tmp_path, "three_records.yaml")).sample(seed=1)
    assert run.converged
    assert len(run.draws) >= 14
    draws = {name: run.draws[name].ravel() for name in TRUTH}
    for name, exponents in PRODUCTS.items():
        product = np.prod([draws[part] ** e for part, e in exponents.items()], axis=0)
        true = np.prod([TRUTH[part] ** e for part, e in exponents.items()])
        low, high = np.quantile(product, [0.005, 0.995])
        assert low <= true <= high, name
        near = {"k_s/j_1": 0.01, "t_cm r_m/k_T": 0.03}.get(name, np.inf)
        assert np.abs(np.array([low, high]) / true - 1).max() < near, name
    assert np.abs(draws["offset_v"] + 0.06).max() < 0.01
    assert np.abs(draws["lag_alpha"] - 3.3e-3).max() < 0.3e-3


# A config without friction, or with a missing torque at the motor in its place.
SIGMA = "{prior: log_uniform, low: 0.005, high: 30}"
FRICTIONLESS = """
name: servo
seed: 3
record:
  file: FILE
  window: [0, 4]
  time: {column: "time [ms]", unit: ms}
  channels:
    theta_2: {column: "theta [deg]", unit: deg, sigma: SIGMA_2}
    alpha: {column: "alpha [deg]", unit: deg, measures: theta_1 - theta_2, sigma: SIGMA_1}
inputs:
  v: {column: "voltage [V]", unit: V}
model: {name: motor_shaft, i_m: 0.0714285714}
nominal:
  {j_m: 4.95e-6, c_m: 2.2e-6, k_e: 0.022, k_T: 0.022, r_m: 1.98, l_m: 0.66e-3, k_s: 0.99,
   j_1: 2.64e-3}
parameters:
  {j_m: J_M, c_m: BOX, k_e: BOX, k_s: BOX, j_1: BOX, k_T: nominal, r_m: nominal, l_m: nominal,
   t_f: 0.0}
map: {starts: 2, evaluations: 500}
""".replace("BOX", "{prior: uniform, low: 0.1, high: 10, relative: true}")
TORQUE = """
missing_torque:
  at: motor
  size: {prior: log_uniform, low: 1.0e-5, high: 0.1}
  time: {prior: log_uniform, low: 1.0e-3, high: 10}
"""


def frictionless(
    folder: Path, name: str, sigmas: tuple[str, str], more: str = "", *changes: tuple[str, str]
) -> bd.Case:
    """Return the case of a record, with noise of `theta_2` and `alpha` and more sections."""
    text = FRICTIONLESS.replace("FILE", str(SIMULATED / f"{name}.csv"))
    text = text.replace("SIGMA_2", sigmas[0]).replace("SIGMA_1", sigmas[1])
    (folder / "servo.yaml").write_text(changed(text, *changes) + more)
    return bd.load(folder / "servo.yaml")


WHOLE_RECORD = ("  window: [0, 4]\n", "")
UNKNOWN_INERTIA = ("J_M", "{prior: uniform, low: 0.1, high: 10, relative: true}")
HELD_INERTIA = ("J_M", "nominal")


@pytest.mark.slow
@simulated
@run_cases("name", ["square", "sweep", "slow"])
def test_the_offset_of_the_supply_and_both_frictions_are_named(name: str, tmp_path: Path) -> None:
    """Rotor 1 has a friction of 12e-3 N m at rest, and 6e-3 N m in motion.

    Frictions of motor and rotor may be parts of their own, or one that is called after both.
    """
    changes = (WHOLE_RECORD, UNKNOWN_INERTIA)
    causes = causes_of(frictionless(tmp_path, name, ("0.05", "0.03"), "", *changes))
    assert causes is not None
    assert max(row.rms for row in causes.given) > 100
    sizes = {size.name: size.value for size in causes.best.new}
    assert {"offset_v", "t_cm", "t_c1"} <= {*sizes}
    assert sizes["offset_v"] == pytest.approx(TRUTH["offset_v"], abs=0.002)
    assert sizes["t_cm"] == pytest.approx(TRUTH["t_cm"], rel=0.15)
    if "t_s1" in sizes:
        assert sizes["t_c1"] == pytest.approx(TRUTH["t_c1"], rel=0.05)
        assert sizes["t_s1"] == pytest.approx(TRUTH["t_s1"], rel=0.05)
    else:  # one friction stands for both
        assert TRUTH["t_c1"] < 1.05 * sizes["t_c1"] < 2.2 * TRUTH["t_c1"]
    assert max(row.rms for row in causes.best.fit) < 5


@pytest.mark.slow
@simulated
def test_a_missing_torque_stands_in_for_all_frictions_of_a_servo(tmp_path: Path) -> None:
    """Offset of the supply and lag of a sensor are not modelled either."""
    case = frictionless(tmp_path, "square", (SIGMA, SIGMA), TORQUE, HELD_INERTIA)
    best = case.find_map(processes=1).mode.values
    assert best["k_s"] / best["j_1"] == pytest.approx(0.9 / 2.4e-3, rel=0.03)


@pytest.mark.slow
@simulated
@run_cases("changes", [(), (WHOLE_RECORD,)], ids=["4 s", "all"])
def test_the_missing_torque_of_a_servo_is_its_friction(
    changes: tuple[tuple[str, str], ...], tmp_path: Path
) -> None:
    """2.5e-3 N m at the motor, and of rotor 1 0.43e-3 to 0.86e-3 at its side of the gear.

    A supply that is 0.06 V lower is -0.67e-3 N m.  The noise is what a rig without friction at rotor
    1 leaves.
    """
    damped = ("J_M", "nominal, c_s: {prior: log_uniform, low: 1.0e-5, high: 0.1}")
    case = frictionless(tmp_path, "square", ("0.3", "0.5"), TORQUE, damped, *changes)
    posterior = case.job.problem.posterior
    values = case.find_map(processes=1).mode.values
    assert values["k_s"] / values["j_1"] == pytest.approx(0.9 / 2.4e-3, rel=0.03)
    rng = seeds.stream(7, "torque")
    drawn = points_near(posterior, posterior.space.vector(values), 50, rng)
    estimate = torque_estimates(posterior, posterior.coordinates.to_physical(drawn), rng)[0]
    first = regress_torque(estimate)[0]
    assert (first.kind, first.of, first.taken) == ("sign", "w_2", True)
    assert 2.4e-3 < -first.size < 3.1e-3
    _, speed = estimate.speeds[0]
    turns = np.abs(speed) > 5.0  # rad/s; the estimate is smooth about a jump
    rows = np.column_stack([np.sign(speed), speed, np.ones(len(estimate.t))])[turns]
    law = np.linalg.lstsq(rows, estimate.expected[turns])[0]
    residuals = estimate.expected[turns] - rows @ law
    assert 1 - np.var(residuals) / np.var(estimate.expected[turns]) > 0.9
    assert law[2] == pytest.approx(-0.06 * 0.022 / 1.98, rel=0.1)


DAMPED = """
name: damped
seed: 3
record:
  window: [0, 2]
  time: {column: "time [ms]", unit: ms}
  channels:
    theta_2: {column: "theta [deg]", unit: deg, sigma: {prior: log_uniform, low: 0.005, high: 50}}
    alpha: {column: "alpha [deg]", unit: deg, measures: theta_1 - theta_2,
            sigma: {prior: log_uniform, low: 0.005, high: 50},
            lag: {prior: uniform, low: -4, high: 12, unit: ms}}
inputs:
  v: {column: "voltage [V]", unit: V, offset: {prior: normal, mean: 0, sd: 0.1}}
experiments:
  square: {record: {file: FOLDER/square.csv}}
  sweep: {record: {file: FOLDER/sweep.csv}}
  slow: {record: {file: FOLDER/slow.csv}}
shared: [offset_v, lag_alpha, sigma_alpha, sigma_theta_2]
model: {name: motor_shaft, i_m: 0.07142857142857142}
nominal:
  {j_m: 4.95e-6, c_m: 2.2e-6, k_e: 0.022, k_T: 0.022, r_m: 1.98, l_m: 0.66e-3, k_s: 0.99,
   j_1: 2.64e-3}
parameters:
  {c_m: {prior: log_uniform, low: 0.1, high: 10, relative: true}, k_T: {tie: k_e}, l_m: nominal,
   t_f: 0.0, c_s: {prior: uniform, low: 0.0, high: 0.05},
   j_m: BOX, k_e: BOX, r_m: BOX, k_s: BOX, j_1: BOX}
map: {starts: 1}
sampler: {walkers: 40, ess: 400, n_tau: 20, max_steps: 500}
"""


@pytest.mark.slow
@simulated
def test_a_maximum_at_the_ends_of_three_priors_is_sampled(tmp_path: Path) -> None:
    """A damped rig without friction fits badly, and its ridges lead out of the priors."""
    box = "{prior: uniform, low: 0.5, high: 1.5, relative: true}"
    path = tmp_path / "damped.yaml"
    path.write_text(changed(DAMPED, ("FOLDER", str(SIMULATED)), ("BOX", box)))
    run = bd.load(path).sample(seed=1)
    assert set(run.draws) >= {"c_s", "k_s"}
