"""Twins of a maximum: what it becomes where branches of a rig that are alike are exchanged.

Two branches of a train that hang on one inertia, and of which no channel sees one, can be called either
way.  Each maximum then has a twin of the same height, which no search for another height would miss.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.rig.models.roles import GROUND, Roles

SAME_HEIGHT = 1e-6  # of the log density, relative: two that are the same but for their names
INERTIA_NAMES = (
    "inertia", "damping", "friction", "sliding", "static", "fading", "drag", "efficiency", "weight",
    "tilt", "angle", "speed",
)  # fmt: skip


def twin_starts(surface: LogDensity, u: Array) -> Iterator[Array]:
    """Yield the twins `(D,)` of a maximum `u (D,)`."""
    posterior = surface.posterior
    observations, free = posterior.likelihood.observations, posterior.space.free
    labels = ["", *(f"_{each.label}" for each in observations if each.label)]
    for exchanged in exchanges(observations[0].response.model.roles):
        pairs = {}
        for name, other in exchanged.items():
            for ending in (f"{start}{label}" for start in ("", "_0") for label in labels):
                pairs[name + ending] = other + ending
        known = {*free}
        moved = [name for name in free if pairs.get(name, name) != name]
        if not moved or any(pairs[name] not in known for name in moved):
            continue
        twin = u[[free.index(pairs.get(name, name)) for name in free]]
        here, there = surface.value(np.stack([u, twin]))
        if abs(here - there) <= SAME_HEIGHT * (1.0 + abs(here)) and not np.array_equal(twin, u):
            yield twin


def exchanges(roles: Roles) -> Iterator[dict[str, str]]:
    """Yield names of parameters and states, each with that of its counterpart in another branch."""
    joined: dict[str, dict[str, str]] = {}  # by inertia: shafts by what is at their other end
    for shaft in roles.shafts:
        for near, far in (shaft.ends, shaft.ends[::-1]):
            joined.setdefault(near, {})[far] = shaft.name
    for at in joined:
        for pair in itertools.combinations((end for end in joined[at] if end != GROUND), 2):
            if (matched := _matched(joined, at, *pair)) is not None:
                yield _names(roles, matched)


def _matched(
    joined: dict[str, dict[str, str]], at: str, first: str, second: str
) -> list[tuple[str, str, str, str]] | None:
    """Return pairs of inertias with the shafts that lead to them; None of branches of other shapes."""
    pairs = list[tuple[str, str, str, str]]()
    before = at, at
    while True:
        shafts = joined[before[0]][first], joined[before[1]][second]
        pairs.append((first, second, *shafts))
        others = [
            [end for end in joined[name] if end != last]
            for name, last in zip((first, second), before, strict=True)
        ]
        if not any(others):
            return pairs
        if [len(ends) for ends in others] != [1, 1] or GROUND in (*others[0], *others[1]):
            return None
        before, (first, second) = (first, second), (others[0][0], others[1][0])


def _names(roles: Roles, matched: list[tuple[str, str, str, str]]) -> dict[str, str]:
    names: dict[str, str] = {}
    shafts = {shaft.name: shaft for shaft in roles.shafts}
    for first, second, own, other in matched:
        ends, links = (roles.inertia(first), roles.inertia(second)), (shafts[own], shafts[other])
        pairs = [(getattr(ends[0], role), getattr(ends[1], role)) for role in INERTIA_NAMES]
        pairs += [(getattr(links[0], x), getattr(links[1], x)) for x in ("stiffness", "damping")]
        for one, two in pairs:
            if one and two:
                names |= {one: two, two: one}
    return names
