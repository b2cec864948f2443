"""One ensemble: seeds, pieces, and what is counted."""

from __future__ import annotations

import numpy as np
from support.known_targets import WILD

from bayesdrill.basics import seeds
from bayesdrill.sampling.samplers.ensemble import State, advance

MOVES = {"differential_evolution": 0.7, "stretch": 0.3}


def target(z: np.ndarray) -> tuple[np.ndarray, int]:
    log_p = WILD.log_density(z)
    far = z[:, 0] > 12.0
    return np.where(far, -np.inf, log_p), int(far.sum())


def begin(seed: int) -> State:
    z = WILD.draw(20, 3, np.random.default_rng(7))
    z[:, 0] = np.minimum(z[:, 0], 11.0)
    return State(z, target(z)[0], seeds.legacy_state(seed, "walk", 0))


def test_same_seed_same_chain_other_seed_another() -> None:
    """Mutant killed: the seed ignored (emcee takes only a legacy tuple)."""
    first = advance(target, begin(1), 30, MOVES)
    assert np.array_equal(first.z, advance(target, begin(1), 30, MOVES).z)
    assert not np.array_equal(first.z, advance(target, begin(2), 30, MOVES).z)


def test_the_chain_does_not_depend_on_how_it_is_cut() -> None:
    whole = advance(target, begin(1), 40, MOVES)
    one = advance(target, begin(1), 13, MOVES)
    two = advance(target, one.state, 27, MOVES)
    assert np.array_equal(np.concatenate([one.z, two.z]), whole.z)
    assert np.array_equal(np.concatenate([one.log_p, two.log_p]), whole.log_p)
    assert np.array_equal(one.accepted + two.accepted, whole.accepted)


def test_global_random_state_is_left_alone() -> None:
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    advance(target, begin(1), 10, MOVES)
    assert np.array_equal(np.random.get_state()[1], before)  # noqa: NPY002


def test_shapes_and_stored_densities() -> None:
    """Mutant killed: chain transposed."""
    piece = advance(target, begin(1), 17, MOVES)
    assert piece.z.shape == (17, 20, 3)
    assert np.allclose(piece.log_p, WILD.log_density(piece.z.reshape(-1, 3)).reshape(17, 20))
    assert np.array_equal(piece.z[-1], piece.state.z)


def test_failures_are_counted_though_never_accepted() -> None:
    piece = advance(target, begin(1), 200, MOVES)
    assert piece.failures > 0
    assert np.isfinite(piece.log_p).all()


def test_streams_differ_by_purpose_and_index() -> None:
    draws = {
        tuple(seeds.stream(3, purpose, index).random(3))
        for purpose in ("map", "start", "walk", "predictive", "prior", "record")
        for index in (0, 1)
    }
    assert len(draws) == 12
    assert np.array_equal(seeds.stream(3, "map").random(3), seeds.stream(3, "map").random(3))
