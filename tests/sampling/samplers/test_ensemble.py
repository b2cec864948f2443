"""One ensemble: seeds, segments, and what is counted."""

import numpy as np
from support.known_targets import WILD

from bayesdrill.basics import seeds
from bayesdrill.sampling.samplers.ensemble import ChainSegment, State, advance

MOVES = {"differential_evolution": 0.7, "stretch": 0.3}


def target(z: np.ndarray) -> tuple[np.ndarray, int]:
    far = z[:, 0] > 12.0
    return np.where(far, -np.inf, WILD.log_density(z)), int(far.sum())


def begin(seed: int = 1) -> State:
    z = WILD.draw(20, 3, np.random.default_rng(7))
    z[:, 0] = np.minimum(z[:, 0], 11.0)
    return State(z, target(z)[0], seeds.legacy_state(seed, "walk", 0))


def walk(steps: int, state: State | None = None) -> ChainSegment:
    return advance(target, state or begin(), steps, MOVES)


def test_the_same_seed_gives_the_same_chain_and_another_seed_another() -> None:
    """emcee itself takes only a legacy tuple."""
    first = walk(30)
    assert np.array_equal(first.z, walk(30).z)
    assert not np.array_equal(first.z, walk(30, begin(2)).z)


def test_the_chain_does_not_depend_on_how_it_is_cut() -> None:
    whole, first = walk(40), walk(13)
    second = walk(27, first.state)
    for name in ("z", "log_p"):
        parts = [getattr(segment, name) for segment in (first, second)]
        assert np.array_equal(np.concatenate(parts), getattr(whole, name))
    assert np.array_equal(first.accepted + second.accepted, whole.accepted)


def test_random_streams_differ_by_purpose_and_index() -> None:
    draws = {
        tuple(seeds.stream(3, purpose, index).random(3))
        for purpose in ("map", "start", "walk", "predictive", "prior", "record")
        for index in (0, 1)
    }
    assert len(draws) == 12
    assert np.array_equal(seeds.stream(3, "map").random(3), seeds.stream(3, "map").random(3))
