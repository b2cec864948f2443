"""The printed matrix and the integrator, against exponentials and laws of the trapezoidal rule."""

import numpy as np
import pytest
import scipy.interpolate
import scipy.linalg
from numpy.typing import NDArray
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, by_expm, skewed
from support.small_problems import STATES, experiment, vector

from bayesdrill.inference import Posterior, derived
from bayesdrill.rig import Model, MotorShaft, Response
from studies.paper import forward, precision
from studies.paper.forward import SIX_STATES, AsPrinted, Solution, integrate, six_states
from studies.paper.tests.records import UNEVEN, at, target

Array = NDArray[np.float64]
I_M = 0.2

FIVE = [SIX_STATES.index(name) for name in STATES]


CHAIN = np.diag(np.ones(3), 1)  # x_1' = x_2, x_2' = x_3, ...


def both(
    p: dict[str, float], rtol: float, n: int = 1001, model: MotorShaft | AsPrinted | None = None
) -> tuple[Solution, np.ndarray, np.ndarray]:
    """The step of 8 V at 100 Hz: what was integrated, its five states, the exact ones."""
    record = experiment(n)
    model = model or MotorShaft()
    matrix, forcing = six_states(model, p, {"v": 8.0})
    solution = integrate(matrix, forcing, np.zeros(6), record.t, rtol, 1e-3 * rtol)
    return solution, solution.x[:, FIVE], Response(model, record).signals(vector(p)[None])[0]


def worst(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.max(np.abs(found - true) / np.abs(true).max(axis=0)))


W_2 = SIX_STATES.index("w_2")


def augmented(model: Model, p: dict[str, float]) -> Array:
    whole = np.zeros((7, 7))
    whole[:6, :6], whole[:6, 6] = six_states(model, p, {"v": 8.0})
    return whole


@run_cases(
    "model, at, i_n",
    [
        (MotorShaft(I_M), "j_m", 1 / I_M),
        (AsPrinted(I_M, i_n=1 / I_M, a_51="j_m"), "j_m", 1 / I_M),
        (AsPrinted(I_M), "j_1", I_M),
        (AsPrinted(I_M, i_n=5.5), "j_1", 5.5),
    ],
)
def test_the_matrix_of_the_equations_and_the_printed_one(model: Model, at: str, i_n: float) -> None:
    """Typed in from the paper: what A(5,1) is over, and i_n."""
    p = skewed()
    k, j1, jm, lm, g = p["k_s"], p["j_1"], p["j_m"], p["l_m"], I_M**2
    typed = np.array(
        [
            [0, 0, 0, 1, 0, 0],
            [0, 0, 0, 0, 1, 0],
            [0, 0, 0, 0, 0, 1],
            [-k / j1, k / j1, 0, 0, 0, 0],
            [g * k / p[at], -g * k / jm, 0, 0, -p["c_m"] / jm, I_M * p["k_T"] / jm],
            [0, 0, 0, 0, -i_n * p["k_e"] / lm, -p["r_m"] / lm],
        ]
    )
    matrix, forcing = six_states(model, p, {"v": 8.0, "t_1": 0.3})
    assert np.allclose(matrix, typed, rtol=1e-14)
    assert forcing == pytest.approx([0, 0, 0, -0.3 / j1, -I_M * p["t_f"] / jm, 8.0 / lm])


@run_cases(
    "model, at_10, at_30, end",
    [
        (AsPrinted(i_n=8.0, a_51="j_m"), (13.4, 16.3), 15.90, 15.91),
        (AsPrinted(i_n=8.0), (-4.5, 2.6), 0.07, 0.0),
        (AsPrinted(a_51="j_m"), (661.1, 658.1), 660.3, 660.3),
        (AsPrinted(), (-244.3, 10.8), -0.4, 0.0),
    ],
)
def test_speeds_that_the_misprints_lead_to(
    model: AsPrinted, at_10: tuple[float, float], at_30: float, end: float
) -> None:
    """Typed in; the end both as `derived` has it and as it is reached after three hours."""
    whole = augmented(model, NOMINAL)
    after_10, after_30, late = (scipy.linalg.expm(t * whole)[FIVE, 6] for t in (10.0, 30.0, 1e4))
    assert after_10[2:4] == pytest.approx(at_10, abs=0.06)
    assert after_30[3] == pytest.approx(at_30, abs=0.06 if abs(at_30) > 0.1 else 0.006)
    told = derived.steady_values(model, model.linear(NOMINAL), 1, {"v": 8.0})
    assert told["w_end"][0] == pytest.approx(end, abs=0.06)
    assert late[2:4] == pytest.approx(told["w_end"].repeat(2), abs=1e-4)
    assert late[4] == pytest.approx(told["i_end"][0], abs=1e-4)


def test_readings_settle_where_they_are_after_hours_and_their_errors_are_the_largest() -> None:
    """From exponentials of the six states, one per sample and one of 20 000 s."""
    for reading in forward.readings(experiment(51, 0.02), skewed()):
        whole = augmented(forward.READINGS[reading.row["name"]][1], skewed())
        end = scipy.linalg.expm(2e4 * whole)[W_2, 6]
        assert reading.row["w_end"] == pytest.approx(end, rel=1e-9, abs=1e-6)
        assert abs(reading.row["w_2"] - end) > 1e-3  # it still swings
        once = scipy.linalg.expm(0.02 * whole)
        x, exact = np.eye(7)[6], []
        for _ in reading.t:
            exact.append(x[W_2])
            x = once @ x
        found = integrate(whole[:6, :6], whole[:6, 6], np.zeros(6), reading.t)
        error = np.abs(found.x[:, W_2] - exact).max()
        assert reading.row["error"] == pytest.approx(error, rel=1e-6)
        assert reading.row["steps"] == found.steps
        assert reading.row["w_2_trapezoid"] == pytest.approx(found.x[-1, W_2])
        assert reading.row["w_2"] == reading.curve[-1] == pytest.approx(exact[-1], abs=1e-6)
        assert reading.row["time"] == reading.t[-1] == 30.0


def test_the_integrators_error_in_each_channel() -> None:
    """Against exponentials, in a channel that is a sum of states and from a start that is not zero."""
    measures = {"twist": {"theta_1": 1.0, "theta_2": -1.0}, "w_2": {"w_2": 2.0}}
    start = {"theta_1": 0.3, "w_2": -1.0, "i": 4.0}
    record = experiment(81, 0.02, measures=measures, start=start)
    x = by_expm(skewed(), record.t, np.array([0.3, 0.0, 0.0, -1.0, 4.0]), 8.0, 0.0)
    exact = np.stack([x[:, 0] - x[:, 1], 2 * x[:, 3]], axis=1)
    found, steps = forward.paper_signals(MotorShaft(), record, vector(skewed()))
    off = found - exact
    assert np.abs(off).max() < 0.03 * np.abs(exact).max()
    for k, error in enumerate(forward.errors(record, skewed())):
        assert error["channel"] == list(measures)[k]
        assert error["largest"] == pytest.approx(np.abs(off[:, k]).max(), rel=1e-5)
        assert error["rms"] == pytest.approx(np.sqrt((off[:, k] ** 2).mean()), rel=1e-5)
        assert error["steps"] == steps


def test_the_integrator_starts_where_the_state_is_given() -> None:
    start = {"theta_1": 0.3, "w_2": -1.0}
    record = experiment(41, 0.02, first=0.5, t_start=0.1, start=start)
    at_start = np.array([0.3, 0.0, 0.0, -1.0, 0.0])
    exact = by_expm(skewed(), record.t - 0.1, at_start, 8.0, 0.0)
    found, _ = forward.paper_signals(MotorShaft(), record, vector(skewed()))
    assert found.shape == exact.shape
    assert np.abs(found - exact)[:, :4].max() < 0.05 * np.abs(exact[:, :4]).max()


def test_a_measured_voltage_is_not_taken_for_none() -> None:
    record = experiment(41, constant={"t_1": 0.0}, series={"v": 8 + np.sin(np.arange(41.0))})
    with pytest.raises(ValueError, match="v must be constant"):
        forward.paper_signals(MotorShaft(), record, vector(NOMINAL))


BOX = ("c_m", "k_e")


@pytest.fixture(scope="module")
def boxed() -> Posterior:
    return target(BOX, UNEVEN, 41, at(BOX, 1.0, 1.0), wide=(0.5, 1.5))


def test_the_misfit_with_the_integrator_is_its_own(boxed: Posterior) -> None:
    y = boxed.likelihood.only_observation.response.experiment.y
    rows, expected = np.array([[0.8, 1.1], [1.4, 0.6]]), []
    for factors in rows:
        p = NOMINAL | at(BOX, *factors)
        matrix, forcing = six_states(MotorShaft(), p, {"v": 8.0})
        x = integrate(matrix, forcing, np.zeros(6), 0.01 * np.arange(41)).x
        off = x[:, [SIX_STATES.index(name) for name in STATES[:4]]] - y
        expected.append(np.mean((off / UNEVEN) ** 2))
    theta = rows * [NOMINAL[name] for name in BOX]
    for one, per in zip(theta, expected, strict=True):
        assert forward.stepped_misfit(boxed.likelihood, one) == pytest.approx(per, rel=1e-9)
    found = forward.stepped_task(precision.misfit_task(boxed), boxed.likelihood).density(theta)
    assert found == pytest.approx(-0.5 * y.size * np.array(expected))


def test_a_search_with_the_integrator_ends_at_the_priors(boxed: Posterior) -> None:
    theta = np.array([[1.6, 1.0], [1.0, 0.4], [1.0, 1.0]]) * [NOMINAL[name] for name in BOX]
    found = forward.stepped_task(precision.misfit_task(boxed), boxed.likelihood).density(theta)
    assert list(found[:2]) == [-np.inf, -np.inf]
    assert np.isfinite(found[2])


@run_cases("p", [NOMINAL, skewed()], ids=["nominal", "skewed"])
def test_agrees_with_the_exact_response_within_thirty_tolerances(p: dict[str, float]) -> None:
    """Each state relative to its largest value over 10 s; the slow swing sums up its errors."""
    solution, found, true = both(p, 1e-3)
    assert 1e-3 < worst(found, true) < 30e-3
    assert 100 < solution.steps < 500
    assert solution.rejected < 0.15 * solution.steps


def test_is_of_second_order() -> None:
    """Errors fall as steps^-2, and so as rtol^(2/3)."""
    runs = [(rtol, *both(NOMINAL, rtol)) for rtol in (1e-3, 1e-4, 1e-5, 1e-6)]
    errors = np.log([worst(found, true) for _, _, found, true in runs])
    steps = np.log([solution.steps for _, solution, _, _ in runs])
    assert np.polyfit(steps, errors, 1)[0] == pytest.approx(-2.0, abs=0.1)
    assert np.polyfit(np.log([run[0] for run in runs]), errors, 1)[0] == pytest.approx(
        2 / 3, abs=0.03
    )


def test_a_stiff_rig_takes_no_more_steps_once_its_current_has_settled() -> None:
    """A pole at -3e4 1/s: an explicit rule would need 150 000 steps."""
    p = {**NOMINAL, "l_m": 1e-2 * NOMINAL["l_m"]}
    solution, found, true = both(p, 1e-3)
    assert worst(found, true) < 30e-3
    assert solution.steps < 1.5 * both(NOMINAL, 1e-3)[0].steps


def test_the_energy_of_a_swing_without_loss_is_kept_to_rounding() -> None:
    """A law of this rule alone, whatever its steps; its phase is late all the same."""
    swing = np.array([[0.0, 1.0], [-4.0, 0.0]])
    x = integrate(swing, np.zeros(2), np.array([1.0, 0.0]), np.array([0.0, 20.0])).x[-1]
    assert 4 * x[0] ** 2 + x[1] ** 2 == pytest.approx(4.0, rel=1e-12)
    assert x[0] != pytest.approx(np.cos(40.0), abs=1e-3)


def test_a_parabola_is_exact_between_the_steps_too() -> None:
    t = np.linspace(1.0, 3.0, 301)
    solution = integrate(CHAIN[:2, :2], np.array([0.0, 3.0]), np.array([0.5, -2.0]), t)
    s = t - 1.0
    assert solution.x[:, 0] == pytest.approx(0.5 - 2.0 * s + 1.5 * s**2, abs=1e-12)
    assert solution.steps < 30


def test_the_free_interpolant_is_hermites_cubic_and_of_third_order() -> None:
    """On ends of steps that obey the rule, and as steps are halved on ends of a sine."""
    swing = np.array([[0.0, 1.0], [-4.0, 0.0]])
    ends = np.cumsum([0.0, 0.1, 0.1, 0.3, 0.05])
    states = [np.array([1.0, 0.5])]
    for h in np.diff(ends):
        left, right = np.eye(2) - 0.5 * h * swing, np.eye(2) + 0.5 * h * swing
        states.append(np.linalg.solve(left, right @ states[-1]))
    slopes = np.array(states) @ swing.T
    t = np.linspace(0.0, ends[-1], 200)
    cubic = scipy.interpolate.CubicHermiteSpline(ends, states, slopes)
    assert forward._between(ends, np.array(states), slopes, t) == pytest.approx(cubic(t), abs=1e-13)
    errors = []
    for n in (20, 40):
        ends = np.linspace(0.0, 3.0, n + 1)
        t = np.linspace(0.0, 3.0, 1001)
        found = forward._between(ends, np.sin(ends)[:, None], np.cos(ends)[:, None], t)[:, 0]
        errors.append(np.abs(found - np.sin(t)).max())
    assert errors[0] / errors[1] == pytest.approx(8.0, rel=0.1)


def test_steps_are_as_long_as_a_known_error_allows() -> None:
    """x_1''' = 1e3, all sizes 1e9: the error is h^3/12 1e3, and four fifths of h = 2.29 s fit.

    x_4 only makes the first step short, 0.08 s; then 0.4 s, then as many as are left of 100 s.
    """
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = CHAIN[:3, :3]
    forcing, start = np.array([0.0, 0.0, 1e3, 1e8]), np.array([1e9, 0.0, 1e3, 0.0])
    found = integrate(matrix, forcing, start, np.array([0.0, 100.0]), rtol=1e-6, atol=1e3)
    fits = 0.8 * (12 * 1e9 * 1e-6 / 1e3) ** (1 / 3)
    assert found.steps == 2 + np.ceil((100.0 - 0.48) / fits - 0.1)
    assert found.rejected == 0
    at_once = integrate(
        matrix[:3, :3], forcing[:3], start[:3], np.array([0.0, 20.0]), rtol=1e-6, atol=1e3
    )
    assert at_once.steps == 10  # a tenth of 20 s each
    assert at_once.rejected == 0


def test_steps_do_not_depend_on_the_times_that_are_asked_for() -> None:
    matrix, forcing = six_states(MotorShaft(), NOMINAL, {"v": 8.0})
    many = integrate(matrix, forcing, np.zeros(6), np.linspace(0.0, 10.0, 1001))
    few = integrate(matrix, forcing, np.zeros(6), np.array([0.0, 2.0, 10.0]))
    assert (many.steps, many.rejected) == (few.steps, few.rejected)
    assert np.array_equal(many.x[[0, 200, 1000]], few.x)


def test_what_runs_away_ends_in_nan() -> None:
    """No endless search for a step, and no warning."""
    t = np.linspace(0.0, 10.0, 11)
    found = integrate(np.array([[100.0]]), np.zeros(1), np.ones(1), t, rtol=1e-2).x[:, 0]
    assert np.isfinite(found[:7]).all()
    assert np.isnan(found[8:]).all()
    no_number = integrate(np.array([[np.nan]]), np.zeros(1), np.ones(1), t).x[:, 0]
    assert no_number[0] == 1.0
    assert np.isnan(no_number[1:]).all()


def test_one_time_is_the_start_and_a_rig_at_rest_stays() -> None:
    start = np.array([1.0, 2.0, 3.0, 4.0])
    one = integrate(CHAIN, np.zeros(4), start, np.array([5.0]))
    assert np.array_equal(one.x, start[None])
    assert one.steps == 0
    rest = integrate(CHAIN, np.zeros(4), np.zeros(4), np.linspace(0.0, 1.0, 9))
    assert not rest.x.any()
    assert rest.steps <= 10


@run_cases(
    "t, rtol, says",
    [([0.0, 0.0], 1e-3, "times"), ([], 1e-3, "times"), ([0.0, 1.0], 0.0, "tolerances")],
)
def test_integration_over_no_time_or_without_tolerance_is_refused(
    t: list[float], rtol: float, says: str
) -> None:
    with pytest.raises(ValueError, match=says):
        integrate(CHAIN, np.zeros(4), np.zeros(4), np.array(t), rtol)
