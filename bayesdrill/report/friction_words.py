"""What records can hardly tell of friction, damping and drop, and which experiment would."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from bayesdrill.insight.identifiability.frictions import Alike, Deeds, Proposal, Told, Unseen

EXPERIMENTS: Mapping[str, str] = {
    "turned": "another experiment with the voltage turned round",
    "turned half-way": "the voltage turned round half-way",
    "stops": "another experiment at so low a voltage that it stops ({volts:.2g} V)",
    "stops half-way": "so low a voltage half-way that it stops ({volts:.2g} V)",
    "half": "another experiment at half the voltage ({volts:.3g} V)",
}
OF: Mapping[str, str] = {"at the motor": "the motor turns", "at rotor 1": "rotor 1 turns"}

# Why two are alike, where it is not by what the rig did.
REASONS: Mapping[frozenset[str], str] = {
    frozenset(("c_s", "c_1")): "both take from each swing, and only c_1 from steady turning",
    frozenset(
        ("eta", "t_cm")
    ): "what a gear loses grows with the torque that it passes on, and t_cm does not",
}


def sentences(found: Told) -> str:
    """A line for each; empty where there is nothing."""
    return "\n".join([*map(_alike, found.alike), *map(_unseen, found.unseen)])


def _alike(one: Alike) -> str:
    known = "it were" if len(one.rivals) == 1 else "these were"
    why = [REASONS[pair] for r in one.rivals if (pair := frozenset((one.name, r))) in REASONS]
    if one.deeds is not None and (did := _did(one.deeds)):
        why.append(f"in these records {did}")
    because = f" ({'; '.join(why)})" if why else ""
    return (
        f"friction: {one.name} can hardly be told from {listed(one.rivals)}{because}: if {known} known, "
        f"its sd would be {_about(one.fall)} times smaller{_proposed(one.name, one.proposals)}"
    )


def _unseen(one: Unseen) -> str:
    speed = f"{one.deeds.slowest:.3g} rad/s"
    return (
        f"friction: static friction {one.deeds.where} does not show: once it turns, it never sticks and "
        f"is never slower than {speed}, while static friction is lost over {one.scale:.3g} rad/s; "
        f"{listed(one.names)} {'is' if len(one.names) == 1 else 'are'} left to the prior"
        f"{_proposed(one.names[0], one.proposals)}"
    )


def _did(deeds: Deeds) -> str:
    """What the rig did not do."""
    turns = OF.get(deeds.where)
    unit = "A" if turns is None else "rad/s"
    what = "the current flows" if turns is None else turns
    speeds = f"{deeds.slowest:.3g} to {deeds.fastest:.3g} {unit}"
    if deeds.one_way:
        return f"{what} one way only, at {speeds}"
    return f"{what} at about one speed, {speeds}" if deeds.one_speed else ""


def _proposed(name: str, proposals: Sequence[Proposal]) -> str:
    each = list(_experiments(proposals))
    return f"; what would show {name}: {', or '.join(each)}" if each else ""


def _experiments(proposals: Sequence[Proposal]) -> Iterator[str]:
    for one in proposals:
        yield f"{EXPERIMENTS[one.what].format(volts=one.volts)} (sd {_about(one.shrink)} times smaller)"


def _about(times: float) -> str:
    """Two digits, and no powers of ten."""
    return f"{float(f'{times:.2g}'):g}"


def listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
