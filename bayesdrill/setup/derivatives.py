"""Channels that are differences of another one: checked, named, and not counted."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayesdrill.basics import units
from bayesdrill.record import angles
from bayesdrill.record.experiment import Odd
from bayesdrill.setup.as_they_come import Column, Findings
from bayesdrill.setup.experiment_entries import ChannelSpec
from bayesdrill.setup.yaml_source import Place

NEAR = 0.3  # of its rms: farther off, a channel is hardly what it is said to be


def tell(columns: Mapping[Place, Column], findings: Findings) -> None:
    """Of each derived channel: that it is not counted, and how well it is what it is said to be."""
    for one in columns.values():
        of = one.spec.derived_from if isinstance(one.spec, ChannelSpec) else None
        if of is None:
            continue
        why = "it has no noise of its own, and would count the same numbers twice"
        not_counted = f"{one.name} is not counted, as it is derived from {of}: {why}"
        found = _compared(one, columns["record", "channels", of])
        if found is None:
            findings.told.append(
                f"{not_counted}; it was not compared, as it has other times or units"
            )
            continue
        kind, off, times = found
        like = f"{times:.4g} times the {kind} difference quotient of {of} to {off:.2g} of its rms"
        findings.told.append(f"{not_counted}; it is {like}")
        if off > NEAR:
            findings.odd.append(
                Odd(
                    said=f"derived: {one.name} is said to be derived from {of}, but is only {like}",
                    where=(),
                    do="; if it was measured by a sensor of its own, remove derived_from",
                )
            )


def _compared(one: Column, of: Column) -> tuple[str, float, float] | None:
    """Which quotient, how far off (of the rms), and how many times it, in SI."""
    if one.clock is not of.clock:
        return None
    both = ~np.isnan(one.values) & ~np.isnan(of.values)
    try:
        turned = units.factor(of.spec.unit, "rad")
        moved = units.factor(one.spec.unit, "rad/s")
    except ValueError:
        return None
    if np.sum(both) < angles.FEWEST:
        return None
    x, w, t = of.values[both] * turned, one.values[both] * moved, one.clock.t[both]
    slope = next(iter(angles.quotients(x, t).values()))
    size = float(slope @ slope)
    times = float(slope @ w[1:-1]) / size if size > 0 else 0.0
    if times == 0.0:
        return None
    return (*angles.nearest_quotient(times * x, w, t), times)
