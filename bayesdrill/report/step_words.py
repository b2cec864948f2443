"""Whether the steps of a rig that rubs are short enough, in sentences and as data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from bayesdrill.inference.pieces import ENOUGH, FINER, StepError


def sentences(found: Sequence[StepError]) -> str:
    """A line for each experiment; nothing of a rig that needs no steps."""
    return "\n".join(map(_said, found))


def _said(one: StepError) -> str:
    where = f" in {one.label}" if one.label else ""
    steps = "one step" if one.pieces == 1 else f"{one.pieces} steps"
    each = ", ".join(
        f"{name} {error:.2g}" for name, error in zip(one.channels, one.errors, strict=True)
    )
    measured = f"{steps} to a sample{where}; {FINER} times as many would move samples by"
    worst = f"{one.worst:.2g} of the noise ({each})"
    if one.fine:
        return f"steps: {measured} at most {worst}, which does no harm"
    return (
        f"steps: TOO FEW: {measured} up to {worst}, and a tenth of it is what may be; say "
        f"`model: {{pieces: {wanted(one)}}}`"
    )


def wanted(one: StepError) -> int:
    """Pieces that are enough, of an error that falls as steps get shorter, the next power of two."""
    return one.pieces << max(1, math.ceil(math.log2(one.worst / ENOUGH)))


def as_data(found: Sequence[StepError]) -> list[dict[str, Any]]:
    """For `run.json`."""
    return [
        {
            **({"experiment": one.label} if one.label else {}),
            "pieces": one.pieces,
            "over_sigma": {
                name: round(error, 6) for name, error in zip(one.channels, one.errors, strict=True)
            },
        }
        for one in found
    ]
