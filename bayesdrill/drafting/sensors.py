"""What each column measures, and in which unit: by its head, then by what columns say of each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array
from bayesdrill.drafting import signals
from bayesdrill.drafting.columns import GEARBOX, MOTOR, ROTOR, SI, TWIST, Seen, believable, span_of
from bayesdrill.drafting.signals import TURNS, Part, Raw, Sensor

FAST = 60.0  # speeds of a rig above it are hardly in rad/s, nor angles a second in rad
SLOWEST = 0.8  # of a motor, in turns for one of the shaft: less is a wrong unit
AWHILE = 10  # samples, fewer than any record has
NAMELESS = 0.999  # of an angle, that the integral of a nameless column has to explain
RPM_WORDS = ("n", "rpm", "drehzahl", "rotacao", "upm")
RADIAN_WORDS = ("w", "omega", "w1", "w2", "wm")


def sensors(columns: Sequence[Seen], part: Part) -> tuple[list[Sensor], dict[str, str]]:
    """Of the columns beside the time; and why others are left out."""
    found, left_out = signals.drafts(columns, part)
    dt = part.dt
    all_ = _by_twist(_by_derivative(found, dt), dt)
    known: list[Sensor] = []
    for one in sorted(all_, key=lambda one: one.place == MOTOR):  # whose size a gear makes
        if one.kind:
            known.append(_with_unit(one, [*all_, *known], dt))
    for one in all_:
        if not one.kind:
            why = "its name says nothing of" if one.name else "nothing says"
            left_out[one.name] = (
                f"({span_of(one.seen)}): {why} what it measures, and it is no derivative of another"
            )
    return known, left_out


def rate(columns: Sequence[Seen]) -> float:
    """Of a record without times, by an angle and its speed in known units, Hz; 0: cannot be told."""
    whole = [c for c in columns if np.all(np.isfinite(c.values)) and believable(c.values)]
    raw = Raw(np.zeros(0), np.zeros(0))
    every = [Sensor(c, c.values, *_told(c), raw) for c in whole if c.says.kind in TURNS]
    known = [one for one in every if one.unit]
    for _, _, factor, share in _followed(known, [one.si for one in known], 1.0):
        if share > signals.EXPLAINED and factor > 0:
            return float(f"{1 / factor:.3g}")
    return 0.0


def _told(one: Seen) -> tuple[str, str, str]:
    says = one.says
    symbol = {"angle": "rad", "speed": "rad/s"}.get(says.kind, "") if says.symbol else ""
    return says.kind, says.place, says.unit or symbol


def _pairs(every: Sequence[Sensor]) -> Iterator[tuple[Sensor, Sensor]]:
    """Angles and speeds that can be of one place; those whose names agree come first."""
    possible = [
        (angle, speed)
        for angle in every
        for speed in every
        if angle is not speed
        and angle.kind in ("angle", "")
        and speed.kind in ("speed", "")
        and TWIST not in (angle.place, speed.place)
        and (angle.place == speed.place or "" in (angle.place, speed.place))
    ]
    yield from sorted(possible, key=lambda pair: not (pair[0].place == pair[1].place != ""))


def _followed(
    every: Sequence[Sensor], values: Sequence[Array], dt: float
) -> Iterator[tuple[Sensor, Sensor, float, float]]:
    """Pairs with the factor by which the angle follows the speed's integral, and how much of it does."""
    angles = {id(one): signals.centred(x) for one, x in zip(every, values, strict=True)}
    turned = {
        id(one): signals.centred(signals.integral(x, dt))
        for one, x in zip(every, values, strict=True)
    }
    for angle, speed in _pairs(every):
        yield angle, speed, *signals.explained_by(angles[id(angle)], turned[id(speed)])


def _by_derivative(every: Sequence[Sensor], dt: float) -> list[Sensor]:
    """Where a speed is the derivative of an angle, the factor between them says both units."""
    found = {id(one): one for one in every}
    trials = []
    for angle, speed, factor, share in _followed(every, [one.values for one in every], dt):
        least = signals.EXPLAINED if angle.kind and speed.kind else NAMELESS
        if share > least:
            named = angle.place == speed.place != ""
            trials.append((not named, -share, angle, speed, factor))
    taken: set[int] = set()
    for *_, angle, speed, factor in sorted(trials, key=lambda trial: trial[:2]):
        if taken & {id(angle), id(speed)}:
            continue
        pair = _settled(found[id(angle)], found[id(speed)], factor)
        if pair is not None:
            found[id(angle)], found[id(speed)] = pair
            taken |= {id(angle), id(speed)}
    return list(found.values())


def _settled(angle: Sensor, speed: Sensor, factor: float) -> tuple[Sensor, Sensor] | None:
    """Both with units, kinds and places as far as such a factor tells them."""
    fitting = signals.units_of(factor, angle.unit, speed.unit)
    if angle.unit and speed.unit:
        wanted = units.factor(speed.unit, "rad/s") / units.factor(angle.unit, "rad")
        if 0.85 < abs(factor) / wanted < 1.18:
            fitting = [(angle.unit, speed.unit)]
    if not fitting and angle.unit and speed.unit and angle.place == speed.place:
        doubt = f"the derivative of {angle.name} is {factor:.3g} times this: wrong units or times"
        return angle, speed.but(doubt=doubt)
    if not fitting:
        return None
    units_ = fitting[1] if len(fitting) > 1 and _degrees(angle, speed) else fitting[0]
    place = angle.place or speed.place
    said = f"the derivative of {angle.name} is {factor:.3g} times {speed.name}"
    pair = []
    for one, kind, unit in ((angle, "angle", units_[0]), (speed, "speed", units_[1])):
        told = one.but(kind=kind, unit=unit, place=place)
        sure = one.unit or (one.seen.says.symbol and len(fitting) > 1)
        also = ", or in degrees" if unit[:3] == "rad" else ", or in radians"
        either = also if len(fitting) > 1 else ""
        doubt = f"no unit is said; {said}, as in {units_[0]} and {units_[1]}{either}"
        told = told.but(why=f"{said}, as it should be") if sure else told.but(doubt=doubt)
        if place and not one.place:
            told = told.but(doubt=f"taken to be where {(angle if one is speed else speed).name} is")
        pair.append(told)
    if factor < 0 and angle.seen.says.backwards == speed.seen.says.backwards:
        pair[1] = pair[1].but(doubt=f"{said}: one of them counts backwards; write `measures: -...`")
    return pair[0], pair[1]


def _degrees(angle: Sensor, speed: Sensor) -> bool:
    """Where a factor of 1 leaves both possible: by the steps of an encoder, by names, by size."""
    if counted := signals.counted_unit(angle.values):
        return counted == "deg"
    if any(one.seen.says.symbol or one.seen.says.word in RADIAN_WORDS for one in (angle, speed)):
        return False
    return float(np.abs(speed.values).max()) > FAST


def _by_twist(every: Sequence[Sensor], dt: float) -> list[Sensor]:
    """A twist is the integral of the difference of two speeds, one of them perhaps before a gear."""
    twists = [one for one in every if one.place == TWIST and one.kind == "angle"]
    rotors = [one for one in every if one.kind == "speed" and one.place == ROTOR]
    others = [one for one in every if one.kind == "speed" and one.place in (GEARBOX, MOTOR)]
    if not (len(twists) == 1 and rotors and others):
        return list(every)
    twist, rotor, other = twists[0], rotors[0], others[0]
    causes = [signals.integral(one.values, dt) for one in (rotor, other)]
    (factor, _), share = signals.explained(twist.values, *causes)
    fitting = signals.units_of(factor, twist.unit, rotor.unit)
    if share < 0.8 or not fitting or (len(fitting) > 1 and not (twist.unit or rotor.unit)):
        return list(every)
    said = (
        f"no unit is said; the derivative of {twist.name} is {factor:.3g} times {rotor.name} less a "
        f"part of {other.name}, as in {fitting[0][0]} and {fitting[0][1]}"
    )
    new = dict(zip((id(twist), id(rotor)), fitting[0], strict=True))
    return [
        one.but(unit=new[id(one)], doubt=said) if id(one) in new and not one.unit else one
        for one in every
    ]


def _with_unit(one: Sensor, all_: Sequence[Sensor], dt: float) -> Sensor:
    """What no header and no relation says is taken from columns of the same kind, words or sizes."""
    if one.unit:
        return one.but(why=f"unit {one.unit}, by its head") if one.seen.says.unit else one
    alike = [other for other in all_ if other.kind == one.kind and other.unit]
    if one.kind in TURNS and alike:
        other = alike[0]
        return one.but(unit=other.unit, doubt=f"no unit is said; taken as that of {other.name}")
    size = float(np.abs(one.values).max())
    word = one.seen.says.word
    match one.kind:
        case "speed" if word in RPM_WORDS:
            unit, reason = "rpm", f"in which {word!r} is mostly counted"
        case "speed" if one.seen.says.symbol or word in RADIAN_WORDS:
            unit, reason = "rad/s", f"in which {word!r} is mostly counted"
        case "speed":
            unit = "rpm" if size > FAST else "rad/s"
            reason = f"by its size alone, up to {size:.3g}"
        case "angle" if counted := signals.counted_unit(one.values):
            unit, reason = counted, "in which its steps make a round number for one turn"
        case "angle" if _outrun(one, all_, dt):
            unit, reason = "deg", "as in rad it would turn further than the motor before the gear"
        case "angle":
            steps = np.abs(one.values[AWHILE:] - one.values[:-AWHILE]) / (AWHILE * dt)
            fast = float(np.percentile(steps, 95)) > FAST
            unit = "deg" if (size > 2 if one.place == TWIST else fast) else "rad"
            reason = f"by its size alone, up to {size:.3g}"
        case "current":
            unit, reason = ("mA" if size > 100 else "A"), f"by its size alone, up to {size:.3g}"
        case "voltage":
            unit, reason = ("mV" if size > 400 else "V"), f"by its size alone, up to {size:.3g}"
        case _:
            unit, reason = SI[one.kind], "the usual one"
    return one.but(unit=unit, doubt=f"no unit is said; {unit}, {reason}", guessed=True)


def _outrun(one: Sensor, all_: Sequence[Sensor], dt: float) -> bool:
    """Whether an angle behind the gear, taken as in rad, turns further than a motor before it."""
    motors = [m for m in all_ if m.place == MOTOR and m.kind == "speed"]
    if not motors or one.place in (MOTOR, TWIST):
        return False
    motor = motors[0]
    unit = motor.unit or ("rpm" if motor.seen.says.word in RPM_WORDS else "rad/s")
    turned = motor.but(unit=unit).angle(dt)
    return abs(signals.ratio(turned, one.values)) < SLOWEST
