"""Lines of `inputs:`: the supply, the load, and the moment at which they act."""

from __future__ import annotations

from collections.abc import Sequence

from bayesdrill.setup.guessing.comments import comment, review, scalar
from bayesdrill.setup.guessing.drafts import Sensor
from bayesdrill.setup.guessing.entries import SUPPLY, Found, address, time_entry
from bayesdrill.setup.guessing.start import Start

UNKNOWN = "  # v: 8.0"  # to be written by the user


def inputs(found: Found) -> list[str]:
    return ["inputs:", *_voltage(found), *_load(found), *_moment(found)]


def constant(found: Found) -> dict[str, str]:
    """The voltage of each experiment that has a constant one of its own."""
    every = {one.label: one.of.found.v for one in found.those.every}
    if found.voltage is not None or any(v is None or v.varies for v in every.values()):
        return {}
    return {
        label: f"{{value: {v.raw.x[0]:.6g}, unit: {v.unit}}}"
        for label, v in every.items()
        if v is not None
    }


def _voltage(found: Found) -> list[str]:
    v = found.lead.of.found.v
    if found.voltage is not None:
        return [f"  v: {found.voltage:.6g}    # V, as it was given, constant from the start on"]
    if v is None:
        doubt = (
            "no column is a voltage. Write the supply here, in V: a number if it was constant, else "
            "`{column: ..., unit: V, hold: zero}`; `bayesdrill check` asks for it"
        )
        return [*review([doubt, *_imposed(found)], 2), UNKNOWN]
    head = [*(line for why in v.why for line in comment(why, 2)), *review(v.doubts, 2)]
    if known := constant(found):
        doubt = f"{v.name} is the same in every row, taken as there from the start on"
        return [*head, *review([doubt], 2), f"  v: {known[found.lead.label]}"]
    hold = (
        "between samples it is taken as it was (zero); a supply that moves smoothly needs `first`"
    )
    largest = max(
        float(abs(one.of.found.v.raw.x).max())
        for one in found.those.every
        if one.of.found.v is not None
    )
    off = f"what the motor gets may differ from it: an unknown, {100 * SUPPLY:g} % of its largest value"
    return [
        *head,
        *review([hold, off], 2),
        *_column(found, "v", v),
        f"      offset: {{prior: normal, mean: 0, sd: {SUPPLY * largest:.2g}}}}}",
    ]


def _imposed(found: Found) -> list[str]:
    """What else may move the rig, where the motion of the gearbox is known and no voltage is."""
    top = [one.name for one in found.channels if one.name in ("w_2", "theta_2")]
    if not top:
        return []
    return [
        f"or {top[0]} was imposed, whatever moved it: then it is no channel but an input, `{top[0]}: "
        "{column: ..., unit: ...}`, of `model: {name: driven_shaft}`, which has no motor (docs/rigs.md)"
    ]


def _load(found: Found) -> list[str]:
    t_1 = found.lead.of.found.t_1
    if t_1 is None:
        return ["  t_1: 0.0    # N m, load on rotor 1: no column is one"]
    head = [*(line for why in t_1.why for line in comment(why, 2)), *review(t_1.doubts, 2)]
    (entry,) = _column(found, "t_1", t_1)
    return [*head, f"{entry.removesuffix(',')}}}"]


def _column(found: Found, name: str, like: Sensor) -> list[str]:
    """Without its end."""
    every = [getattr(one.of.found, name) for one in found.those.every]
    entries = [address(like), f"unit: {scalar(like.unit)}", "hold: zero"]
    if any(one is not None and one.raw.missing for one in every):
        entries.append("missing: hold")
    return [f"  {name}: {{{', '.join([*file_entries(found, name), *entries])},"]


def file_entries(found: Found, name: str) -> list[str]:
    """Of an input that stands in another file than the channels."""
    lead = found.lead
    if lead.inputs is None or getattr(lead.inputs.found, name) is None:
        return []
    own = time_entry(lead.inputs.time)
    file = [] if found.several else [f"file: {scalar(found.name(lead.inputs.path))}"]
    return [*file, *([own] if own != time_entry(lead.of.time) else [])]


def _moment(found: Found) -> list[str]:
    """Unknown within a sample; of a constant voltage that was there before, there is none."""
    starts: Sequence[Start] = list(found.starts.values())
    if not found.measured and any(one.moving for one in starts):
        return []
    before, after = (max(one.switched[k] for one in starts) * found.dt for k in (0, 1))
    doubt = (
        "when it acts is known to one sample at best, and an error of half a one shifts j_m by many "
        "standard deviations: an unknown"
    )
    entry = f"  t_0: {{prior: uniform, low: {-before:.4g}, high: {after:.4g}}}    # s"
    return [*review([doubt], 2), entry]
