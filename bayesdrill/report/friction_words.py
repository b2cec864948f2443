"""What records can hardly tell of friction, damping and drop, and which experiment would."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from bayesdrill.insight.identifiability.frictions import Alike, Deeds, Proposal, Told, Unseen
from bayesdrill.rig.models.roles import Roles

EXPERIMENTS: Mapping[str, str] = {
    "turned": "another experiment with the voltage turned round",
    "turned half-way": "the voltage turned round half-way",
    "stops": "another experiment at so low a voltage that it stops ({volts:.2g} V)",
    "stops half-way": "so low a voltage half-way that it stops ({volts:.2g} V)",
    "half": "another experiment at half the voltage ({volts:.3g} V)",
}


def _reasons(roles: Roles) -> Mapping[frozenset[str], str]:
    """Why two are alike, where it is not by what the rig did."""
    motor, shaft, rotor = roles.motor, roles.shaft, roles.rotor
    swings = f"both take from each swing, and only {rotor.damping} from steady turning"
    loses = (
        f"what a gear loses grows with the torque that it passes on, and {motor.sliding} does not"
    )
    return {
        frozenset((shaft.damping, rotor.damping)): swings,
        frozenset((motor.efficiency, motor.sliding)): loses,
    }


def sentences(found: Told) -> str:
    """A line for each; empty where there is nothing."""
    alike = (_alike(one, found.roles) for one in found.alike)
    return "\n".join([*alike, *map(_unseen, found.unseen)])


def _alike(one: Alike, roles: Roles) -> str:
    known, reasons = "it were" if len(one.rivals) == 1 else "these were", _reasons(roles)
    why = [reasons[pair] for r in one.rivals if (pair := frozenset((one.name, r))) in reasons]
    if one.deeds is not None and (did := _did(one.deeds, roles)):
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


def _did(deeds: Deeds, roles: Roles) -> str:
    """What the rig did not do."""
    what, unit = {
        roles.motor.speed: ("the motor turns", "rad/s"),
        roles.rotor.speed: ("rotor 1 turns", "rad/s"),
    }.get(deeds.against, ("the current flows", "A"))
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
