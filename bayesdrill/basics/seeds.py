"""Derive independent random streams for all purposes from one integer seed."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np

Purpose = Literal[
    "record",
    "map",
    "start",
    "walk",
    "predictive",
    "prior",
    "learn",
    "calibrate",
    "identify",
    "study",
    "around",
    "starts",
    "scout",
    "rank",
    "evidence",
    "torque",
    "design",
    "campaign",
]

_ORDER: tuple[Purpose, ...] = get_args(Purpose)


def _sequence(seed: int, purpose: Purpose, index: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(_ORDER.index(purpose), index))


def stream(seed: int, purpose: Purpose, index: int = 0) -> np.random.Generator:
    """Return the generator for a purpose and an index, such as the index of an ensemble."""
    return np.random.default_rng(_sequence(seed, purpose, index))


def bits(seed: int, purpose: Purpose, index: int = 0) -> np.random.MT19937:
    """Return a bit generator for NumPy's legacy `RandomState`, which emcee uses."""
    return np.random.MT19937(_sequence(seed, purpose, index))


def legacy_state(seed: int, purpose: Purpose, index: int = 0) -> tuple[Any, ...]:
    """Return a `RandomState` as a legacy tuple; emcee silently ignores states of other types."""
    state = np.random.RandomState(bits(seed, purpose, index)).get_state(legacy=True)
    assert isinstance(state, tuple)
    return state
