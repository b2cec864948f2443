"""What is learnt before any walker steps: weights of maxima, bent ridges, the same in any chunks."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from support.case_tables import run_cases
from support.closed_form_densities import (
    Gaussians,
    humps,
    learned,
    ridge_point,
    ridged,
    without_density,
)
from support.compiled_responses import SIGMA, seen

from bayesdrill.inference.laplace import LogDensity, QuadraticModel, concatenate_models
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling.proposal.learning import (
    LearnedProposal,
    _central_draws,
    _compared,
    _draw,
    _initial_mixture,
    _most_efficient,
    learn,
)
from bayesdrill.sampling.proposal.ridge_tracing import trace
from bayesdrill.sampling.samplers.independence import WeightedDraws, effective_count, normalised

APART = 20.0  # standard deviations
HUMPS = {"equal": ((0.5, 0.5), (1.0, 1.0)), "one of ten": ((0.9, 0.1), (1.0, 0.5))}


@cache
def two_humps(kind: str, d: int) -> tuple[Gaussians, LearnedProposal]:
    surface = humps(d, *HUMPS[kind], APART)
    return surface, learned(surface, surface.means)


@run_cases("kind", HUMPS)
@run_cases("d", [1, 2, 5])
def test_weights_of_two_maxima_are_those_of_importance_sampling(kind: str, d: int) -> None:
    surface, proposal = two_humps(kind, d)
    u, log_q = proposal.proposal.draw(20_000, surface.in_support, np.random.RandomState(3))
    weights = normalised(surface.value(u) - log_q)
    shares = np.bincount(surface.belongs(u), weights=weights)
    assert shares == pytest.approx(surface.weights, rel=0.1)
    drawn = np.bincount(surface.belongs(u)) / len(u)
    assert proposal.mode_fractions(u, 2) == pytest.approx(drawn, abs=1e-6)
    assert proposal.origin == (0, 1)
    assert proposal.draws.acceptance > 0.8


@run_cases("d", [1, 2])
def test_humps_thousands_of_their_widths_apart_are_learnt(d: int) -> None:
    """As aliases are."""
    surface = humps(d, (0.7, 0.3), (0.01, 0.005), 2000.0)
    draws = learned(surface, surface.means).draws
    assert draws.effective_share > 0.9
    assert draws.acceptance > 0.9


def test_a_proposal_is_compared_with_what_another_has_seen() -> None:
    """By its own draws alone one that knows a single hump would be the better."""
    surface, random = humps(2, (0.6, 0.4), (1.0, 1.0), APART), np.random.RandomState(1)
    traced = [trace(surface, u, np.random.default_rng(2)) for u in surface.means]
    single, both = (
        _draw(_initial_mixture(traced[:n]), (0, 1)[:n], surface, random) for n in (1, 2)
    )
    assert single.efficiency > both.efficiency
    lesser, better = _compared(single, both)
    assert lesser.missed == pytest.approx(0.4, abs=0.03)
    assert better.missed < 1e-3
    assert lesser.efficiency < 0.2 * better.efficiency
    for order in ([single, both], [both, single]):
        assert len(_most_efficient(order).origin) == 2


def test_a_maximum_without_mass_costs_nothing() -> None:
    surface = humps(2, (1.0, 1e-30), (1.0, 1.0), APART)
    proposal = learned(surface, surface.means)
    assert proposal.draws.acceptance > 0.8
    drawn, _ = proposal.proposal.draw(3000, surface.in_support, np.random.RandomState(3))
    assert proposal.mode_fractions(drawn, 2)[1] < 0.02


@run_cases("n_loose, n_tight", [(1, 1), (1, 3), (2, 3)])
def test_a_bent_ridge_is_learnt(n_loose: int, n_tight: int) -> None:
    """Over hundreds of standard deviations, which change along it, within walls."""
    surface = ridged(n_loose, n_tight)
    draws = learned(surface, [ridge_point(surface)]).draws
    assert draws.acceptance > 0.7
    e = surface.parts(draws.u)[1]
    assert draws.weights @ e == pytest.approx(np.zeros(n_tight), abs=0.15)
    assert draws.weights @ e**2 == pytest.approx(np.ones(n_tight), abs=0.15)


class Chunked(LogDensity):
    """Expanded about `size` points at a time."""

    def __init__(self, posterior: Posterior, size: int) -> None:
        super().__init__(posterior)
        self.size = size

    def quadratic_model(self, u: np.ndarray, directions: np.ndarray) -> QuadraticModel:
        chunks = [u[k : k + self.size] for k in range(0, len(u), self.size)]
        expand = super().quadratic_model
        return concatenate_models([expand(chunk, directions) for chunk in chunks])


def numbers(proposal: LearnedProposal) -> list[bytes]:
    mixture, draws = proposal.proposal.mixture, proposal.draws
    sheets = [array for sheet in mixture.sheets for array in (sheet.location, sheet.root)]
    arrays = [mixture.weights, mixture.means, mixture.roots, *sheets, draws.u, draws.weights]
    return [array.tobytes() for array in arrays]


def test_the_proposal_does_not_depend_on_how_points_are_divided() -> None:
    """To the last bit, from a record; another seed learns another proposal."""
    target = seen("step", SIGMA, free=("k_T", "r_m", "k_s", "j_1"))
    start = target.coordinates.from_physical(target.space.vector(target.space.start)[None])[0]

    def learn_in_chunks(size: int, seed: int = 1) -> list[bytes]:
        random, rng = np.random.RandomState(seed), np.random.default_rng(seed)
        return numbers(learn(Chunked(target, size), [start], random, rng))

    whole = learn_in_chunks(10**6)
    for size in (7, 32):
        assert learn_in_chunks(size) == whole
    assert learn_in_chunks(10**6, 2) != whole


def test_weights_are_flattened_no_more_than_they_must() -> None:
    log_w = 50.0 * np.random.default_rng(6).standard_normal(1000)

    def flatten(log_w: np.ndarray) -> np.ndarray:
        return WeightedDraws(np.zeros((len(log_w), 1)), log_w, np.zeros(len(log_w))).tempered(100.0)

    flat = flatten(log_w)
    assert flat.sum() == pytest.approx(1.0)
    assert effective_count(flat) == pytest.approx(100.0, rel=1e-3)
    assert np.array_equal(np.argsort(flat), np.argsort(log_w))
    gentle = 0.1 * log_w / 50.0
    assert flatten(gentle) == pytest.approx(normalised(gentle))
    with_zero = flatten(np.append(log_w, -np.inf))
    assert with_zero[-1] == 0.0
    assert np.isfinite(with_zero).all()


def test_a_surface_without_density_is_an_error() -> None:
    surface = humps(2, (0.5, 0.5), (1.0, 1.0), APART)
    with pytest.raises(ValueError, match="no point of finite posterior"):
        learned(without_density(surface), surface.means)


def test_the_middle_of_a_single_draw_is_that_draw() -> None:
    """Where hardly any draw had a density."""
    surface, proposal = two_humps("equal", 2)
    u = surface.means[:1] + 0.1
    single = SimpleNamespace(
        weighted_draws=(u, np.ones(1)), proposal=proposal.proposal, origin=proposal.origin
    )
    ((origin, middle, (drawn, weights)),) = _central_draws(single)
    assert origin == 0
    assert middle.tolist() == u[0].tolist() == drawn[0].tolist()
    assert weights == pytest.approx([1.0])
