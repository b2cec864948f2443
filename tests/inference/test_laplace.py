"""Slopes, curvatures and information of a posterior against differences of its density."""

from collections.abc import Callable

import numpy as np
import pytest
from support import two_experiments
from support.case_tables import run_cases
from support.compiled_responses import SIGMA, seen
from support.missing_physics import ar1
from support.missing_torque_cases import step_with_torque
from support.scipy_oracles import NOMINAL, ORDER
from support.small_problems import likelihood_of, near_middle, unknown

from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.basics.formulas import expression
from bayesdrill.inference import laplace
from bayesdrill.inference.laplace import LogDensity, concatenate_models
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import HalfNormal, LogNormal, Prior, TruncatedNormal, Uniform
from bayesdrill.inference.unknowns import ParameterSpace

FAMILIES: dict[str, Prior] = {
    "c_m": HalfNormal(2 * NOMINAL["c_m"]),  # not in logs
    "k_s": LogNormal(NOMINAL["k_s"], 0.2),
    "j_1": TruncatedNormal(NOMINAL["j_1"], 0.3 * NOMINAL["j_1"]),  # nor this
}


def tied() -> Posterior:
    """Return one in which k_T is k_e, and k_s the stiffness of two shafts in series."""
    target = seen("step", None, priors=FAMILIES)
    unknowns = [one for one in target.space.unknowns if one.name not in ("k_T", "k_s")]
    at = 1 + [one.name for one in unknowns].index("t_f")
    unknowns[at:at] = [unknown(name, Uniform(0.3, 0.9)) for name in ("k_a", "k_b")]
    known = (*ORDER, "k_a", "k_b")
    formulas = {"k_T": "k_e", "k_s": "1/(1/k_a + 1/k_b)"}
    relations = {name: expression(text, known) for name, text in formulas.items()}
    space = ParameterSpace(model=ORDER, unknowns=tuple(unknowns), fixed={}, relations=relations)
    old = target.likelihood.only_observation
    likelihood = likelihood_of(space, (old.response, old.noise))
    return Posterior(space=space, likelihood=likelihood, coordinates=space.coordinates)


LINEAR: dict[str, Callable[[], Posterior]] = {
    "logs": lambda: seen("step", SIGMA),
    "linear, noise unknown": lambda: seen("step", None, priors=FAMILIES),
    "tied": tied,
    "straight inputs": lambda: seen("straight inputs", None),
    "noise alone": lambda: seen("step", None, free=()),
}
ALL = LINEAR | {
    "two experiments": lambda: two_experiments.rich_job().problem.posterior,
    "missing torque": lambda: step_with_torque()[0],
}


def points(target: Posterior, n: int = 3) -> np.ndarray:
    """Return coordinates `(n, D)` between the middles of the priors and their ends."""
    return target.coordinates.from_physical(near_middle(target.space, n))


def differences(
    function: Callable[[np.ndarray], np.ndarray], u: np.ndarray, h: np.ndarray
) -> np.ndarray:
    """Return slopes of the fourth order by each coordinate `(D, W, ...)`, over steps `h (D,)`."""
    slopes = []
    for step in np.diag(h):
        near = function(u + step) - function(u - step)
        far = function(u + 2 * step) - function(u - 2 * step)
        slopes.append((8 * near - far) / (12 * step.sum()))
    return np.array(slopes)


@run_cases("physical, name", [(physical, name) for physical in [False, True] for name in ALL])
def test_slopes_are_those_of_the_density(physical: bool, name: str) -> None:
    """Over the coordinates with their Jacobian, and over the unknowns themselves without it."""
    target = ALL[name]()
    surface = LogDensity(target, physical=physical)
    u, step = points(target), 1e-4 * np.minimum(surface.spread, 1.0)
    model = surface.quadratic_model(u, np.eye(u.shape[1]))
    assert np.array_equal(model.value, surface.value(u))
    numeric = differences(surface.value, u, step).T * surface.spread
    rounding = 1e-8 * np.abs(numeric).max() + 1e-5
    assert model.slope * surface.spread == pytest.approx(numeric, rel=1e-5, abs=rounding)


@run_cases("name", LINEAR)
def test_curvatures_are_those_of_least_squares(name: str) -> None:
    """J'J of the signals, twice what is left of the record (or the number of samples, where that is
    more) for the log of a noise level, and what the priors add."""
    target = LINEAR[name]()
    surface, likelihood = LogDensity(target), target.likelihood
    u = points(target)
    h = 1e-4 * surface.spread
    to_physical = target.coordinates.to_physical
    theta = to_physical(u)
    observation = likelihood.only_observation
    sigmas, noise = observation.scales(theta), observation.noise
    slopes = differences(lambda z: likelihood.signals(to_physical(z)), u, h) / sigmas[:, None]
    expected = np.einsum("dwtk,ewtk->wde", slopes, slopes)
    squares = ((observation.experiment.y - likelihood.signals(theta)) ** 2).sum(axis=1)
    for column, k in enumerate(noise.unknown, start=u.shape[1] - len(noise.unknown)):
        by_log = 1.0 if target.coordinates.logs[column] else 1.0 / sigmas[:, k]
        left = np.maximum(squares[:, k] / sigmas[:, k] ** 2, noise.n_samples)
        expected[:, column, column] += 2.0 * left * by_log**2
    for d, prior in enumerate(target.space.priors.values()):
        step = 30.0 * h * np.eye(u.shape[1])[d]
        down, here, up = (prior.logpdf(to_physical(u + k * step)[:, d]) for k in (-1, 0, 1))
        expected[:, d, d] += np.maximum(-(up - 2 * here + down) / (30.0 * h[d]) ** 2, 0.0)
    scale = np.outer(surface.spread, surface.spread)
    curvature = surface.quadratic_model(u, np.eye(u.shape[1])).curvature * scale
    rounding = 1e-7 * np.abs(expected * scale).max()
    assert curvature == pytest.approx(expected * scale, rel=1e-4, abs=rounding)


@run_cases("name", LINEAR)
def test_a_point_does_not_depend_on_its_neighbours(name: str) -> None:
    """To the last bit, however many there are: products of matrices round as their sizes have it."""
    target = LINEAR[name]()
    surface = LogDensity(target)
    u = points(target, 22)
    rng = np.random.default_rng(3)
    for q in (1, 3, u.shape[1]):
        directions = rng.standard_normal((u.shape[1], q))
        whole = surface.quadratic_model(u, directions)
        for size in (1, 11):
            slices = [u[k : k + size] for k in range(0, 22, size)]
            parts = [surface.quadratic_model(part, directions) for part in slices]
            model = concatenate_models(parts)
            assert model.value == pytest.approx(whole.value, rel=1e-15)
            assert np.array_equal(model.slope, whole.slope)
            assert np.array_equal(model.curvature, whole.curvature)


def test_ends_and_spreads_are_those_of_the_priors() -> None:
    surface = LogDensity(LINEAR["linear, noise unknown"]())
    for end in (surface.low, surface.high):
        assert surface.in_support(end[None]).all()
        assert np.isfinite(surface.value(end[None])).all()
    draws = surface.posterior.space.draw(20_000, np.random.default_rng(1))
    u = surface.posterior.coordinates.from_physical(draws)
    assert surface.spread == pytest.approx(u.std(axis=0), rel=0.03)
    assert surface.middle == pytest.approx(u.mean(axis=0), abs=0.05 * surface.spread.max())


@run_cases("name", ALL)
def test_slopes_of_signals_and_of_single_samples_are_exact(name: str) -> None:
    """Differences of the fourth order over 1e-3 of an unknown err by some 1e-10 of the largest."""
    target = ALL[name]()
    theta = near_middle(target.space, 1)
    natural = target.coordinates.natural(theta)[0]
    for observation in target.likelihood.observations:
        seen = observation.experiment.is_measured

        def signals(at: np.ndarray, observation: Observation = observation) -> np.ndarray:
            return observation.signals(target.space.full(at))

        def terms(at: np.ndarray, observation: Observation = observation) -> np.ndarray:
            return observation.pointwise(observation.experiment.y - signals(at), at)

        at = laplace.natural_directions(target, theta[0])
        slopes = observation.signal_slopes(at)
        for function, exact in ((signals, slopes), (terms, observation.scores(at, slopes))):
            numeric = differences(function, theta, 1e-3 * natural)[:, 0]
            numeric = (numeric * natural[:, None, None])[:, seen]
            rounding = 1e-8 * np.abs(numeric).max()
            assert exact[:, seen] == pytest.approx(numeric, rel=1e-7, abs=rounding)


# --- information -----------------------------------------------------------------------------------


def test_the_information_of_a_point_is_that_of_slopes_and_priors() -> None:
    """An unknown that may be negative counts on the scale of its prior, not of its log."""
    posterior = ALL["two experiments"]()
    theta = near_middle(posterior.space, 1)[0]
    root = laplace.information_root(posterior, theta)
    rows = SensitivityStudy(posterior.likelihood).with_nuisances(theta)
    m = rows.shape[1]
    known = np.diag([1 / laplace.natural_sd(u) ** 2 for u in posterior.space.unknowns[:m]])
    expected = rows.T @ rows / laplace.residual_excess(posterior, theta) + known
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert (root.T @ root)[:m, :m] / scale == pytest.approx(expected / scale, abs=1e-5)
    signed = {u.name for u in posterior.space.unknowns if u.signed}
    assert {"offset_v_late", "t_0_late", "lag_twist_late", "w_1_0_moving"} <= signed
    assert not {"gain_twist", "k_e", "t_f_late", "sigma_twist"} & signed


def test_the_curvature_with_a_missing_torque_is_on_average_the_fisher_information() -> None:
    """The mean of squared slopes of 60 records that are drawn at one point, to four sigma."""
    target, rng = step_with_torque()[0], np.random.default_rng(9)
    observation = target.likelihood.only_observation
    theta = target.space.vector(target.space.start)[None]
    clean = observation.signals(target.space.full(theta))
    slopes, curvatures = [], []
    for _ in range(60):
        record = target.edit(records=[observation.draw(clean, theta, rng)[0]])
        slope, curvature = LogDensity(record).record_slopes(theta, np.eye(theta.shape[1]))
        slopes.append(slope[0])
        curvatures.append(np.diag(curvature[0]))
    ratio = np.mean(np.square(slopes), axis=0) / np.mean(curvatures, axis=0)
    assert ratio == pytest.approx(np.ones(len(ratio)), abs=4 * np.sqrt(2 / 60))


@run_cases("rho, within", [(0.0, 0.05), (0.5, 0.1), (0.9, 0.2), (-0.5, 0.1)])
def test_the_variance_of_a_sum_counts_correlations_at_all_lags(rho: float, within: float) -> None:
    """Of an AR(1) it is (1 + rho) / (1 - rho) times that of as many independent numbers."""
    x = ar1(rho, (20_000, 2), 7)
    ratio = np.diag(laplace.long_run_variance(x)) / len(x) * (1 - rho) / (1 + rho)
    assert ratio == pytest.approx([1.0, 1.0], abs=within)
