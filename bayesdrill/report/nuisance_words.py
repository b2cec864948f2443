"""What sensors, the start, physics that is missing and the moment of a step have to do with a fit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from typing import Any

from bayesdrill.basics import symbols, units
from bayesdrill.insight.causes import NOISE, Cause, Causes
from bayesdrill.insight.instead import Instead
from bayesdrill.insight.moments import Moment
from bayesdrill.rig import vocabulary
from bayesdrill.rig.models.roles import Roles
from bayesdrill.setup import build, experiments, own_units
from bayesdrill.setup.config import Config

LAGS = ("lag", "input lag")
WIDER = 2.0  # times what was found, of a prior that is proposed

# Roles of parameters that a rig may lack.
LACKED: Mapping[str, str] = {
    "motor.sliding": "dry friction at the motor",
    "rotor.sliding": "dry friction at rotor 1",
    "motor.drop": "a voltage drop of driver and brushes",
    "rotor.damping": "viscous damping at rotor 1",
    "shaft.damping": "damping of the shaft",
}


def explained(found: Causes | None, config: Config) -> str:
    """What would explain what the fit leaves, with the lines of a config that say so."""
    if found is None:
        return ""
    if not found.explains:
        return (
            "fit: no gain, offset or lag of a sensor, no other start and no friction or damping that "
            f"the rig offers explains what is left (at most {100 * found.share:.0f} % of it): look at "
            "units, gear, inputs and the model"
        )
    still = f" (down to {math.sqrt(found.rest):.2g} sigma)" if found.rest > NOISE else ""
    said = [
        f"fit: {_percent(found.share)} of what is left beyond noise would be explained{still} by",
        *_each(found, config),
    ]
    if found.other is not None:
        said += ["fit: or, as well as by these, by", *_each(found.other, config)]
    return "\n".join(said)


def _each(found: Causes, config: Config) -> Iterable[str]:
    for (kind, of), group in groupby(found.found, key=_group):
        yield f"  - {_said(kind, of, list(group), config)}"


def _percent(share: float) -> str:
    """Never more than it is."""
    return f"{math.floor(1000 * share) / 10:.3g} %"


def lacking(found: Causes | None, roles: Roles) -> str:
    """What the model misses, for a verdict that stands on it; empty where nothing is known."""
    if found is None or not found.explains:
        return ""
    names = found.lacking or (found.other.lacking if found.other is not None else ())
    return " and ".join(f"{_lacked(name, roles)} ({name})" for name in names)


def instead(found: Instead | None, roles: Roles) -> Iterable[str]:
    """A table that may be right after all."""
    if found is None:
        return
    how = "better than" if found.lost < 0 else "about as well as"
    missing = _missing(found.parameter, found.value, roles)
    yield (
        f"before the table is blamed: its values with {missing} explain the "
        f"record {how} any without; {_named(found.parameter, found.value)}, and ask again"
    )


def _lacked(name: str, roles: Roles) -> str:
    return next(said for role, said in LACKED.items() if roles[role] == name)


def _missing(name: str, value: float, roles: Roles) -> str:
    unit = vocabulary.PARAMETERS[name].plain_unit
    return f"{_lacked(name, roles)} of {value:.3g} {unit}"


def _named(name: str, value: float) -> str:
    """How a config switches it on."""
    return f"say `parameters: {{{name}: {{prior: uniform, low: 0, high: {WIDER * value:.2g}}}}}`"


def as_data(found: Causes | None) -> dict[str, Any] | None:
    """For `run.json`, SI."""
    if found is None:
        return None
    return {
        "share": round(found.share, 4),
        "left_over_sigma": round(math.sqrt(found.rest), 4),
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
        **({} if found.other is None else {"or": as_data(found.other)}),
    }


def instead_as_data(found: Instead | None) -> dict[str, Any]:
    """An entry of `run.json`, SI, where there is something to say."""
    if found is None:
        return {}
    said = {"parameter": found.parameter, "value": found.value, "log_likelihood": -found.lost}
    return {"instead": said}


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
    if kind == "rig":
        (one,) = group
        return (
            f"{_missing(one.of, one.value, build.model(config).roles)}: {_named(one.of, one.value)}"
        )
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
