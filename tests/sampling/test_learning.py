"""What is learnt before any walker steps: the weights of maxima, and the same whatever the chunks."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from support.case_tables import run_cases
from support.closed_form_densities import Gaussians, humps, ridged
from support.compiled_responses import SIGMA, seen

from bayesdrill.inference.laplace import (
    LogDensity,
    QuadraticModel,
    concatenate_models,
)
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling.proposal.learning import (
    LearnedProposal,
    _begin,
    _best,
    _central_draws,
    _compared,
    _draw,
    learn,
)
from bayesdrill.sampling.proposal.ridge_tracing import trace
from bayesdrill.sampling.samplers.ensemble import State, advance
from bayesdrill.sampling.samplers.independence import WeightedDraws, effective_count, normalised

APART = 20.0  # standard deviations
UNEQUAL = {"equal": ((0.5, 0.5), (1.0, 1.0)), "one of ten": ((0.9, 0.1), (1.0, 0.5))}
HUMPS = [(kind, d) for kind in UNEQUAL for d in (1, 2, 5)]


@cache
def two(kind: str, d: int) -> tuple[Gaussians, LearnedProposal]:
    surface = humps(d, *UNEQUAL[kind], APART)
    seed, rng = np.random.RandomState(1), np.random.default_rng(2)
    return surface, learn(surface, list(surface.means), seed, rng)


@run_cases("kind, d", HUMPS)
def test_weights_of_two_maxima_without_a_chain(kind: str, d: int) -> None:
    """From importance weights of draws.  Mutant killed: the weights of components left out of q."""
    surface, learnt = two(kind, d)
    u, log_q = learnt.proposal.draw(20_000, surface.inside, np.random.RandomState(3))
    weights = normalised(surface.value(u) - log_q)
    found = np.bincount(surface.belongs(u), weights=weights)
    assert found == pytest.approx(surface.weights, rel=0.1)
    assert learnt.shares(u, 2) == pytest.approx(np.bincount(surface.belongs(u)) / len(u), abs=1e-6)
    assert learnt.origin == (0, 1)
    assert learnt.draws.acceptance > 0.8


@pytest.mark.parametrize("d", [1, 2])
def test_humps_thousands_of_their_widths_apart_are_met(d: int) -> None:
    """As aliases are.  Mutant killed: a component is no narrower than a hundredth of what parts them."""
    surface = humps(d, (0.7, 0.3), (0.01, 0.005), 2000.0)
    seed, rng = np.random.RandomState(1), np.random.default_rng(2)
    learnt = learn(surface, list(surface.means), seed, rng)
    assert learnt.draws.share > 0.9
    assert learnt.draws.acceptance > 0.9


def test_a_proposal_is_held_against_what_another_has_seen() -> None:
    """By its own draws one that knows a single hump is the better.  Mutant killed: those alone count."""
    surface, seed = humps(2, (0.6, 0.4), (1.0, 1.0), APART), np.random.RandomState(1)
    traced = [trace(surface, u, np.random.default_rng(2)) for u in surface.means]
    one, both = (_draw(_begin(traced[:n]), (0, 1)[:n], surface, seed) for n in (1, 2))
    assert one.worth > both.worth
    left, kept = _compared(one, both)
    assert left.missed == pytest.approx(0.4, abs=0.03)
    assert kept.missed < 1e-3
    assert left.worth < 0.2 * kept.worth
    assert len(_best([one, both]).origin) == 2
    assert len(_best([both, one]).origin) == 2


@run_cases("kind, d", HUMPS)
def test_weights_of_two_maxima_from_walkers_that_start_on_both_alike(kind: str, d: int) -> None:
    """The same mutant killed: walkers would come to be shared as the proposal's draws are not."""
    surface, learnt = two(kind, d)
    rng = np.random.default_rng(4)
    start = surface.means[np.arange(100) % 2] + 0.1 * rng.standard_normal((100, d))
    state = State(start, surface.value(start), np.random.RandomState(5).get_state())
    piece = advance(
        lambda u: (surface.value(u), 0),
        state,
        200,
        {"independence": 0.8, "differential_evolution": 0.2},
        learnt.proposal,
        surface.inside,
    )
    where = surface.belongs(piece.z[20:].reshape(-1, d))
    assert np.bincount(where) / len(where) == pytest.approx(surface.weights, rel=0.1)


def test_a_maximum_that_holds_nothing_costs_nothing() -> None:
    """Nor does one whose ridge is as another's."""
    surface = humps(2, (1.0, 1e-30), (1.0, 1.0), APART)
    seed, rng = np.random.RandomState(1), np.random.default_rng(2)
    learnt = learn(surface, list(surface.means), seed, rng)
    assert learnt.draws.acceptance > 0.8
    drawn, _ = learnt.proposal.draw(3000, surface.inside, np.random.RandomState(3))
    assert learnt.shares(drawn, 2)[1] < 0.02


@run_cases("n_loose, n_tight", [(1, 1), (1, 3), (2, 3)])
def test_a_bent_ridge_is_learnt(n_loose: int, n_tight: int) -> None:
    """Hundreds of standard deviations, which change along it, within walls.

    Mutants killed: one covariance for the whole ridge, or its logs on the diagonal left out.
    """
    surface = ridged(n_loose, n_tight)
    start = surface.at(np.full((1, n_loose), 0.1), np.zeros((1, n_tight)))[0]
    seed, rng = np.random.RandomState(1), np.random.default_rng(3)
    learnt = learn(surface, [start], seed, rng)
    assert learnt.draws.acceptance > 0.7
    e = surface.parts(learnt.draws.u)[1]
    assert learnt.draws.weights @ e == pytest.approx(np.zeros(n_tight), abs=0.15)
    assert learnt.draws.weights @ e**2 == pytest.approx(np.ones(n_tight), abs=0.15)


class Chunked(LogDensity):
    """Expanded about so many points at a time."""

    def __init__(self, posterior: Posterior, size: int) -> None:
        super().__init__(posterior)
        self.size = size

    def quadratic_model(self, u: np.ndarray, directions: np.ndarray) -> QuadraticModel:
        parts = [
            super(Chunked, self).quadratic_model(u[k : k + self.size], directions)
            for k in range(0, len(u), self.size)
        ]
        return concatenate_models(parts)


def test_what_is_learnt_does_not_depend_on_how_the_points_are_shared() -> None:
    """To the last bit, from a record; and another seed learns another proposal."""
    target = seen("step", SIGMA, free=("k_T", "r_m", "k_s", "j_1"))
    start = target.coordinates.from_physical(target.space.vector(target.space.start)[None])[0]

    def learnt(size: int, seed: int = 1) -> LearnedProposal:
        random, rng = np.random.RandomState(seed), np.random.default_rng(seed)
        return learn(Chunked(target, size), [start], random, rng)

    whole = learnt(10**6)
    for size in (1, 7, 32):
        assert same(learnt(size), whole)
    assert not same(learnt(10**6, 2), whole)


def same(one: LearnedProposal, other: LearnedProposal) -> bool:
    mixtures = [found.proposal.mixture for found in (one, other)]
    pairs = [[getattr(m, name) for m in mixtures] for name in ("weights", "means", "roots")]
    sheets = zip(*(m.sheets for m in mixtures), strict=True)
    pairs += [[getattr(s, name) for s in pair] for pair in sheets for name in ("location", "root")]
    pairs += [[one.draws.u, other.draws.u], [one.draws.weights, other.draws.weights]]
    return all(np.array_equal(a, b) for a, b in pairs)


def test_weights_are_flattened_no_more_than_they_must() -> None:
    """Mutant killed: weights of which one holds all."""
    log_w = 50.0 * np.random.default_rng(6).standard_normal(1000)

    def flattened(log_w: np.ndarray) -> np.ndarray:
        return WeightedDraws(np.zeros((len(log_w), 1)), log_w, np.zeros(len(log_w))).tempered(100.0)

    flat = flattened(log_w)
    assert flat.sum() == pytest.approx(1.0)
    assert effective_count(flat) == pytest.approx(100.0, rel=1e-3)
    assert np.array_equal(np.argsort(flat), np.argsort(log_w))
    gentle = 0.1 * log_w / 50.0
    assert flattened(gentle) == pytest.approx(normalised(gentle))
    none = flattened(np.append(log_w, -np.inf))
    assert none[-1] == 0.0
    assert np.isfinite(none).all()


def test_no_density_at_all_is_said() -> None:
    class Nowhere(Gaussians):
        def value(self, u: np.ndarray) -> np.ndarray:
            return np.full(len(u), -np.inf)

    like = humps(2, (0.5, 0.5), (1.0, 1.0), APART)
    surface = Nowhere(**{name: getattr(like, name) for name in like.__dataclass_fields__})
    seed, rng = np.random.RandomState(1), np.random.default_rng(2)
    with pytest.raises(ValueError, match="no point of finite posterior"):
        learn(surface, list(surface.means), seed, rng)


def test_the_middle_of_a_single_draw_is_that_draw() -> None:
    """Where hardly any had a density.  Mutant killed: only draws that weigh more than others."""
    surface, learnt = two("equal", 2)
    u = surface.means[:1] + 0.1
    one = SimpleNamespace(
        weighted_draws=(u, np.ones(1)), proposal=learnt.proposal, origin=learnt.origin
    )
    ((origin, middle, (drawn, own)),) = _central_draws(one)  # type: ignore[arg-type]
    assert origin == 0
    assert middle.tolist() == u[0].tolist() == drawn[0].tolist()
    assert own == pytest.approx([1.0])
