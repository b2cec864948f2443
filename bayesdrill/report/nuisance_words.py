"""What sensors, the start and the moment of a step have to do with a fit, in sentences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

from bayesdrill.basics import symbols, units
from bayesdrill.insight.causes import Cause, Causes
from bayesdrill.insight.moments import Moment
from bayesdrill.setup import experiments, own_units
from bayesdrill.setup.config import Config

LAGS = ("lag", "input lag")
WIDER = 2.0  # times what was found, of a prior that is proposed


def explained(found: Causes | None, config: Config) -> str:
    """What would explain what the fit leaves, with the lines of a config that say so."""
    if found is None:
        return ""
    if not found.explains:
        return (
            "fit: no gain, offset or lag of a sensor and no other start explains what is left (at "
            f"most {100 * found.share:.0f} % of it): look at units, gear, inputs and the model"
        )
    said = [
        _said(kind, of, list(group), config)
        for (kind, of), group in groupby(found.found, key=_group)
    ]
    return (
        f"fit: {100 * found.share:.3g} % of what is left beyond noise would be explained by\n"
        + "\n".join(f"  - {one}" for one in said)
    )


def as_data(found: Causes | None) -> dict[str, Any] | None:
    """For `run.json`, SI."""
    if found is None:
        return None
    return {
        "share": round(found.share, 4),
        "by": [
            {
                "kind": one.kind,
                "of": one.of,
                **({"experiment": one.experiment} if one.experiment else {}),
                "value": one.value,
                "sd": one.sd,
            }
            for one in found.found
        ],
    }


def moment(found: Moment | None) -> Iterable[str]:
    """How much half a sample of it matters; nothing where it hardly does."""
    if found is None or not found.matters:
        return
    moved = sorted(found.shifts, key=lambda one: -abs(one[1]))
    named = ", ".join(
        f"{name} by {abs(shift):.2g}" for name, shift in moved[:3] if abs(shift) > 0.1
    )
    width = 2 * found.seconds
    yield (
        f"moment: inputs half a sample ({1e3 * found.seconds:.3g} ms) later than recorded would move "
        f"{named} sds, and leave what looks like noise; where that may be, say `inputs: {{t_0: {{prior: "
        f"uniform, low: -{width:.3g}, high: {width:.3g}}}}}`"
    )


def _group(cause: Cause) -> tuple[str, str]:
    return cause.kind, "" if cause.kind == "start" else cause.of


def _said(kind: str, of: str, group: Sequence[Cause], config: Config) -> str:
    if kind == "start":
        inside = {one.experiment for one in group}
        where = f" ({', '.join(sorted(inside))})" if inside != {""} else ""
        return f"another state at the start{where}: say `initial: free`"
    each = ", ".join(
        f"{_number(one, config)}{f' in {one.experiment}' if one.experiment else ''}"
        for one in group
    )
    largest = max(group, key=lambda one: abs(one.value))
    if kind in LAGS:
        of = f"inputs.{of}" if kind == "input lag" else of
        bound = WIDER * abs(largest.value)
        low, high = (0.0, bound) if largest.value > 0 else (-bound, 0.0)
        return f"a lag of {of}: {each}: say `lag: {{prior: uniform, low: {low:.3g}, high: {high:.3g}}}`"
    if kind == "gain":
        return f"a gain of {of}: {each}: say `gain: {{prior: normal, mean: 1, sd: 0.1}}`"
    width = WIDER * abs(largest.value) / _unit(largest, config).factor
    where = f"inputs.{of}" if kind == "input offset" else of
    return (
        f"an offset of {where}: {each}: say `offset: {{prior: normal, mean: 0, sd: {width:.2g}}}`"
    )


def _unit(cause: Cause, config: Config) -> units.Unit:
    alone = experiments.of(config, cause.experiment)
    if cause.kind == "input offset":
        return own_units.given(alone, cause.of)
    if cause.kind == "offset":
        return units.shown(alone.record.channels[cause.of].unit)
    return units.Unit("", 1.0, "")


def _number(cause: Cause, config: Config) -> str:
    if cause.kind in LAGS:
        return f"{1e3 * cause.value:.3g} ms"
    unit = _unit(cause, config)
    return f"{cause.value / unit.factor:.3g} {symbols.plain(unit.name)}".strip()
