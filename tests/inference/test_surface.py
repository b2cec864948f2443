"""Slopes and curvatures of a posterior against differences of its density and of its signals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from support.case_tables import run_cases
from support.compiled_responses import SIGMA, seen
from support.scipy_oracles import NOMINAL, ORDER
from support.small_problems import likelihood_of, unknown

from bayesdrill.basics.formulas import expression
from bayesdrill.inference.laplace import LogDensity, QuadraticModel, concatenate_models
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import HalfNormal, LogNormal, Prior, TruncatedNormal, Uniform
from bayesdrill.inference.unknowns import ParameterSpace

FAMILIES: dict[str, Prior] = {
    "c_m": HalfNormal(2 * NOMINAL["c_m"]),  # not in logs
    "k_s": LogNormal(NOMINAL["k_s"], 0.2),
    "j_1": TruncatedNormal(NOMINAL["j_1"], 0.3 * NOMINAL["j_1"]),  # nor this
}


def tied() -> Posterior:
    """One parameter the same as another, and one a sum of two quantities' reciprocals."""
    target = seen("step", None, priors=FAMILIES)
    unknowns = [one for one in target.space.unknowns if one.name not in ("k_T", "k_s")]
    at = 1 + [one.name for one in unknowns].index("t_f")
    unknowns[at:at] = [unknown(name, Uniform(0.3, 0.9)) for name in ("k_a", "k_b")]
    known = (*ORDER, "k_a", "k_b")
    space = ParameterSpace(
        model=ORDER,
        unknowns=tuple(unknowns),
        fixed={},
        relations={
            "k_T": expression("k_e", known),
            "k_s": expression("1/(1/k_a + 1/k_b)", known),
        },
    )
    old = target.likelihood.only_observation
    likelihood = likelihood_of(space, (old.response, old.noise))
    return Posterior(space=space, likelihood=likelihood, coordinates=space.coordinates)


TARGETS: dict[str, Callable[[], Posterior]] = {
    "logs": lambda: seen("step", SIGMA),
    "linear, noise unknown": lambda: seen("step", None, priors=FAMILIES),
    "tied": tied,
    "zero-order hold": lambda: seen("zero-order hold", SIGMA[:2], priors=FAMILIES),
    "first-order hold": lambda: seen("first-order hold", None),
    "noise alone": lambda: seen("step", None, free=()),
}


def points(target: Posterior, n: int = 3) -> np.ndarray:
    """Between the middle of the priors and their ends."""
    shares = 0.5 + np.random.default_rng(4).uniform(-0.3, 0.3, (n, len(target.space.free)))
    priors = target.space.priors.values()
    columns = [prior.quantile(share) for prior, share in zip(priors, shares.T, strict=True)]
    return target.coordinates.from_physical(np.stack(columns, axis=-1))


def differences(function: Callable[[np.ndarray], np.ndarray], u: np.ndarray, h: np.ndarray):
    """`(D, W, ...)`: slopes of the fourth order by each coordinate, over steps `h (D,)`."""
    out = []
    for step in np.diag(h):
        near = function(u + step) - function(u - step)
        far = function(u + 2 * step) - function(u - 2 * step)
        out.append((8 * near - far) / (12 * step.sum()))
    return np.array(out)


@run_cases("physical, name", [(physical, name) for physical in [False, True] for name in TARGETS])
def test_slopes_are_those_of_the_density(physical: bool, name: str) -> None:
    """Mutants killed: the slope of the Jacobian, of the prior or of the noise level left out."""
    target = TARGETS[name]()
    surface = LogDensity(target, physical=physical)
    u = points(target)
    found = surface.quadratic_model(u, np.eye(u.shape[1]))
    assert np.array_equal(found.value, surface.value(u))
    numeric = differences(surface.value, u, 1e-4 * surface.spread).T * surface.spread
    scale = np.abs(numeric).max()
    assert found.slope * surface.spread == pytest.approx(numeric, rel=1e-5, abs=1e-8 * scale + 1e-5)


@run_cases("name", TARGETS)
def test_curvatures_are_those_of_least_squares(name: str) -> None:
    """J'J from differences of the signals, of a noise level twice what is left of the record (or
    the number of samples, where that is more), and what the priors add."""
    target = TARGETS[name]()
    surface, likelihood = LogDensity(target), target.likelihood
    u = points(target)
    h = 1e-4 * surface.spread
    to = target.coordinates.to_physical
    theta = to(u)
    sigmas = likelihood.only_observation.scales(theta)
    noise = likelihood.only_observation.noise
    slopes = differences(lambda z: likelihood.signals(to(z)), u, h) / sigmas[:, None]
    expected = np.einsum("dwtk,ewtk->wde", slopes, slopes)
    squares = (
        (likelihood.only_observation.response.experiment.y - likelihood.signals(theta)) ** 2
    ).sum(axis=1)
    for column, k in enumerate(noise.unknown, start=u.shape[1] - len(noise.unknown)):
        by_log = 1.0 if target.coordinates.logs[column] else 1.0 / sigmas[:, k]
        left = np.maximum(squares[:, k] / sigmas[:, k] ** 2, noise.n_samples)
        expected[:, column, column] += 2.0 * left * by_log**2
    for d, prior in enumerate(target.space.priors.values()):
        step = 30.0 * h * np.eye(u.shape[1])[d]
        down, here, up = (prior.logpdf(to(u + k * step)[:, d]) for k in (-1, 0, 1))
        bent = -(up - 2 * here + down) / (30.0 * h[d]) ** 2
        expected[:, d, d] += np.maximum(bent, 0.0)
    scale = np.outer(surface.spread, surface.spread)
    found = surface.quadratic_model(u, np.eye(u.shape[1])).curvature * scale
    assert found == pytest.approx(
        expected * scale, rel=1e-4, abs=1e-7 * np.abs(expected * scale).max()
    )


@run_cases("name", TARGETS)
def test_fewer_directions_are_parts_of_all(name: str) -> None:
    """Slanted ones, of which noise levels are part too."""
    target = TARGETS[name]()
    surface = LogDensity(target)
    u = points(target)
    d = u.shape[1]
    directions = surface.spread[:, None] * np.random.default_rng(2).standard_normal((d, 3))
    whole, some = surface.quadratic_model(u, np.eye(d)), surface.quadratic_model(u, directions)
    assert some.slope == pytest.approx(whole.slope @ directions, rel=1e-8)
    along = directions.T @ whole.curvature @ directions
    assert some.curvature == pytest.approx(along, rel=1e-7, abs=1e-9 * np.abs(along).max())


@run_cases("name", TARGETS)
def test_a_point_does_not_depend_on_its_neighbours(name: str) -> None:
    """To the last bit, however many there are.

    Mutant killed: one product of matrices for all points, which rounds as their number has it.
    """
    target = TARGETS[name]()
    surface = LogDensity(target)
    u = points(target, 22)
    rng = np.random.default_rng(3)
    for q in (1, 3, u.shape[1]):
        directions = rng.standard_normal((u.shape[1], q))
        together = surface.quadratic_model(u, directions)
        for size in (1, 11):
            parts = [
                surface.quadratic_model(u[k : k + size], directions) for k in range(0, 22, size)
            ]
            assert_same(concatenate_models(parts), together)


def assert_same(one: QuadraticModel, other: QuadraticModel) -> None:
    assert one.value == pytest.approx(other.value, rel=1e-15)
    assert np.array_equal(one.slope, other.slope)
    assert np.array_equal(one.curvature, other.curvature)


def test_a_response_that_overflows_has_no_slopes_and_leaves_its_neighbours_alone() -> None:
    target = seen("step", SIGMA, priors={"l_m": Uniform(0.0, 1.0)}, logs=False)
    surface = LogDensity(target)
    u = points(target, 5)
    well = surface.quadratic_model(u, np.eye(9))
    u[2, ORDER.index("l_m")] = 1e-320
    sick = surface.quadratic_model(u, np.eye(9))
    assert sick.value[2] == -np.inf
    assert not sick.slope[2].any()
    assert not sick.curvature[2].any()
    others = [0, 1, 3, 4]
    parts = [[e.value[others], e.slope[others], e.curvature[others]] for e in (sick, well)]
    assert_same(*(QuadraticModel(*part) for part in parts))


def test_the_ends_are_those_of_the_priors() -> None:
    """What stands at one is inside; the spreads are those of the priors over the coordinates."""
    surface = LogDensity(TARGETS["linear, noise unknown"]())
    for end in (surface.low, surface.high):
        assert surface.inside(end[None]).all()
        assert np.isfinite(surface.value(end[None])).all()
    draws = surface.posterior.space.draw(20_000, np.random.default_rng(1))
    u = surface.posterior.coordinates.from_physical(draws)
    assert surface.spread == pytest.approx(u.std(axis=0), rel=0.03)
    assert surface.middle == pytest.approx(u.mean(axis=0), abs=0.05 * surface.spread.max())
