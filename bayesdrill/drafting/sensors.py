"""Identify quantity and unit of each column from headers, then from relations between columns."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.drafting import signals
from bayesdrill.drafting.columns import (
    DRIVES,
    GEARBOX,
    MOTOR,
    ROTOR,
    SI,
    TWIST,
    FileColumn,
    contradiction,
)
from bayesdrill.drafting.signals import TURNS, RawSamples, Segment, Sensor
from bayesdrill.record.regression import integral

FAST_SPEED = 60.0  # speeds above it are hardly in rad/s, and angles with such rates hardly in rad
MIN_GEAR = 0.8  # motor turns per shaft turn; a smaller ratio shows a wrong unit
SUPPLY_RIPPLE = 0.1  # relative range below which a voltage is a nearly constant supply
SPEED_SAMPLES = 10  # number of steps over which the speed of an angle is computed
NAMELESS_SHARE = 0.999  # least fraction of variance to be explained if a kind is unknown
RPM_WORDS = ("n", "rpm", "drehzahl", "rotacao", "upm")
RADIAN_WORDS = ("w", "omega", "w1", "w2", "wm")


def identify_sensors(
    columns: Sequence[FileColumn], segment: Segment
) -> tuple[list[Sensor], dict[str, str]]:
    """Return the usable columns as sensors with units, and why the other columns are not used."""
    drafts, unused = signals.read_sensors(columns, segment)
    dt = segment.dt
    sensors = _by_twist(_by_derivative(drafts, dt), dt)
    known: list[Sensor] = []
    for sensor in sorted(sensors, key=lambda s: s.location == MOTOR):  # motors last: they are fast
        if sensor.kind:
            known.append(_with_unit(sensor, [*sensors, *known], dt))
        else:
            why = f"{'its name does not say' if sensor.name else 'nothing says'} what it measures"
            why += ", and it is not the derivative of another column"
            unused[sensor.name] = f"({sensor.column.range_text}): {why}"
    moving = [s for s in known if s.kind not in DRIVES and s.location != TWIST]
    both_ways = any(signals.reverses(sensor, signals.CLEAR_REVERSAL_RATIO) for sensor in moving)
    kept = list[Sensor]()
    for sensor in known:
        doubt = _doubt_of_drive(sensor) if both_ways else ""
        if doubt and sensor.kind == "voltage" and not sensor.column.meaning.is_given:
            unused[sensor.name] = doubt
        else:
            kept.append(sensor.revised(doubt=doubt and f"it {doubt}"))
    return kept, unused


def _doubt_of_drive(sensor: Sensor) -> str:
    """Return why a sensor cannot measure the drive of a rig that turns both ways; empty if it can."""
    low, middle, high = np.quantile(sensor.raw.x, (0.05, 0.5, 0.95))
    if sensor.kind == "voltage" and high - low < SUPPLY_RIPPLE * abs(middle):
        return "hardly changes while the rig turns both ways: a supply, not the motor's voltage"
    if sensor.kind == "current" and (sensor.raw.x.min() >= 0 or sensor.raw.x.max() <= 0):
        sign = "never changes its sign while the rig turns both ways"
        return f"{sign}. If it is the absolute value, remove it"
    return ""


def infer_rate(columns: Sequence[FileColumn]) -> float:
    """Return the rate [Hz] of a record without times, from an angle and its speed; 0 if unknown."""
    raw, known = RawSamples(np.zeros(0), np.zeros(0)), []
    for column in columns:
        meaning, x = column.meaning, column.values
        unit = meaning.unit or (SI[meaning.kind] if meaning.symbol else "")
        if meaning.kind in TURNS and unit and np.isfinite(x).all() and signals.is_plausible(x):
            known.append(Sensor(column, x, meaning.kind, meaning.location, unit, raw))
    for _, _, factor, fraction in _derivatives(known, [sensor.si for sensor in known], 1.0):
        if fraction > signals.EXPLAINED_SHARE and factor > 0:
            return float(f"{1 / factor:.3g}")
    return 0.0


def _same_location(angle: Sensor, speed: Sensor) -> bool:
    return angle.location == speed.location != ""


def _derivatives(
    sensors: Sequence[Sensor], values: Sequence[Array], dt: float
) -> Iterator[tuple[Sensor, Sensor, float, float]]:
    """Yield angle, speed, factor (angle = factor * integral of speed), explained variance."""
    angles, integrals = dict[int, Array](), dict[int, Array]()
    for sensor, x in zip(sensors, values, strict=True):
        angles[id(sensor)], integrated = x - x.mean(), integral(x, dt)
        integrals[id(sensor)] = integrated - integrated.mean()
    pairs = [
        (angle, speed)
        for angle, speed in itertools.permutations(sensors, 2)
        if angle.kind in ("angle", "") and speed.kind in ("speed", "")
        if TWIST not in (angle.location, speed.location)
        if angle.location == speed.location or "" in (angle.location, speed.location)
    ]
    for angle, speed in sorted(pairs, key=lambda pair: not _same_location(*pair)):
        yield angle, speed, *signals.explained_by(angles[id(angle)], integrals[id(speed)])


def _by_derivative(sensors: Sequence[Sensor], dt: float) -> list[Sensor]:
    """Return the sensors; if a speed is the derivative of an angle, both of them get units."""
    revised = {id(sensor): sensor for sensor in sensors}
    trials = []
    for angle, speed, factor, fraction in _derivatives(sensors, [s.values for s in sensors], dt):
        if fraction > (signals.EXPLAINED_SHARE if angle.kind and speed.kind else NAMELESS_SHARE):
            trials.append((not _same_location(angle, speed), -fraction, angle, speed, factor))
    paired: set[int] = set()
    for *_, angle, speed, factor in sorted(trials, key=lambda trial: trial[:2]):
        if paired.isdisjoint({id(angle), id(speed)}) and (pair := _resolve(angle, speed, factor)):
            revised[id(angle)], revised[id(speed)] = pair
            paired |= {id(angle), id(speed)}
    return list(revised.values())


def _resolve(angle: Sensor, speed: Sensor, factor: float) -> tuple[Sensor, Sensor] | None:
    """Return angle and speed with the kinds, units and locations that fit; None if no unit fits."""
    fitting = signals.units_by_factor(factor, angle.unit, speed.unit)
    known = angle.unit != "" and speed.unit != ""
    if known and 0.85 < abs(factor) / signals.derivative_factor(angle.unit, speed.unit) < 1.18:
        fitting = [(angle.unit, speed.unit)]
    if not fitting and known and angle.location == speed.location:
        doubt = f"the derivative of {angle.name} is {factor:.3g} times this: wrong units or times"
        return angle, speed.revised(doubt=doubt)
    if not fitting:
        return None
    ambiguous = len(fitting) > 1
    pair_units = fitting[1] if ambiguous and _in_degrees(angle, speed) else fitting[0]
    location = angle.location or speed.location
    relation = f"the derivative of {angle.name} is {factor:.3g} times {speed.name}"
    pair = []
    for sensor, other, kind, unit in (
        (angle, speed, "angle", pair_units[0]),
        (speed, angle, "speed", pair_units[1]),
    ):
        revised = sensor.revised(kind=kind, unit=unit, location=location)
        if sensor.unit or (sensor.column.meaning.symbol and ambiguous):
            revised = revised.revised(why=f"{relation}, as it should be")
        else:
            also = ", or in degrees" if unit[:3] == "rad" else ", or in radians"
            doubt = f"no unit is stated; {relation}, as in {pair_units[0]} and {pair_units[1]}"
            revised = revised.revised(doubt=doubt + also if ambiguous else doubt)
        if location and not sensor.location:
            revised = revised.revised(doubt=f"taken to be at the location of {other.name}")
        pair.append(revised)
    if factor < 0 and angle.column.meaning.is_reversed == speed.column.meaning.is_reversed:
        doubt = f"{relation}: one of them counts backwards; write `measures: -...`"
        pair[1] = pair[1].revised(doubt=doubt)
    return pair[0], pair[1]


def _in_degrees(angle: Sensor, speed: Sensor) -> bool:
    """Return whether an ambiguous pair is in degrees: by encoder steps, by names, or by size."""
    if counted := signals.counted_unit(angle.values):
        return counted == "deg"
    meanings = (angle.column.meaning, speed.column.meaning)
    if any(meaning.symbol or meaning.kind_word in RADIAN_WORDS for meaning in meanings):
        return False
    return float(np.abs(speed.values).max()) > FAST_SPEED


def _by_twist(sensors: Sequence[Sensor], dt: float) -> list[Sensor]:
    """Return the sensors; units are added if a twist is the integral of a speed difference."""
    twists = [sensor for sensor in sensors if sensor.location == TWIST and sensor.kind == "angle"]
    speeds = [sensor for sensor in sensors if sensor.kind == "speed"]
    rotors = [speed for speed in speeds if speed.location == ROTOR]
    others = [speed for speed in speeds if speed.location in (GEARBOX, MOTOR)]
    if not (len(twists) == 1 and rotors and others):
        return list(sensors)
    twist, rotor, other = twists[0], rotors[0], others[0]
    causes = [integral(speed.values, dt) for speed in (rotor, other)]
    (factor, _), fraction = signals.explained(twist.values, *causes)
    fitting = signals.units_by_factor(factor, twist.unit, rotor.unit)
    if fraction < 0.8 or not fitting or (len(fitting) > 1 and not (twist.unit or rotor.unit)):
        return list(sensors)
    doubt = f"no unit is stated; the derivative of {twist.name} is {factor:.3g} times {rotor.name}"
    doubt += f" minus a part of {other.name}, as in {fitting[0][0]} and {fitting[0][1]}"
    new = dict(zip((id(twist), id(rotor)), fitting[0], strict=True))
    return [
        s.revised(unit=new[id(s)], doubt=doubt) if id(s) in new and not s.unit else s
        for s in sensors
    ]


def _with_unit(sensor: Sensor, sensors: Sequence[Sensor], dt: float) -> Sensor:
    """Return the sensor with a unit: its own, the unit of a similar sensor, or a guess."""
    meaning = sensor.column.meaning
    if sensor.unit:
        source = signals.GIVEN_REASON if meaning.is_given else "by its header"
        why = f"unit {sensor.unit}, {source}" if meaning.unit else ""
        return sensor.revised(why=why, doubt=contradiction(meaning))
    if sensor.kind in TURNS:
        for other in sensors:
            if other.kind == sensor.kind and other.unit:
                doubt = f"no unit is stated; taken as that of {other.name}"
                return sensor.revised(unit=other.unit, doubt=doubt)
    unit, reason = _guess_unit(sensor, sensors, dt)
    if sensor.kind == "angle" and np.array_equal(sensor.raw.x, np.round(sensor.raw.x)):
        reason += ". All values are whole: if an encoder counts N steps a turn, write count/N"
    return sensor.revised(unit=unit, doubt=f"no unit is stated; {unit}, {reason}", guessed=True)


def _guess_unit(sensor: Sensor, sensors: Sequence[Sensor], dt: float) -> tuple[str, str]:
    """Return a unit guessed from a word of the header, from steps or from size, and the reason."""
    size, word = float(np.abs(sensor.values).max()), sensor.column.meaning.kind_word
    by_word = f"the usual unit of {word!r}"
    by_size = f"judged by its size alone, up to {size:.3g}"
    match sensor.kind:
        case "speed" if word in RPM_WORDS:
            return "rpm", by_word
        case "speed" if sensor.column.meaning.symbol or word in RADIAN_WORDS:
            return "rad/s", by_word
        case "speed":
            return "rpm" if size > FAST_SPEED else "rad/s", by_size
        case "angle" if counted := signals.counted_unit(sensor.values):
            return counted, "in which one turn has a round number of steps"
        case "angle" if _outruns_motor(sensor, sensors, dt):
            return "deg", "because in rad it would turn further than the motor before the gear"
        case "angle":
            steps = np.abs(sensor.values[SPEED_SAMPLES:] - sensor.values[:-SPEED_SAMPLES])
            fast = float(np.percentile(steps / (SPEED_SAMPLES * dt), 95)) > FAST_SPEED
            return "deg" if (size > 2 if sensor.location == TWIST else fast) else "rad", by_size
        case "current":
            return "mA" if size > 100 else "A", by_size
        case "voltage":
            return "mV" if size > 400 else "V", by_size
    return SI[sensor.kind], "the usual unit"


def _outruns_motor(sensor: Sensor, sensors: Sequence[Sensor], dt: float) -> bool:
    """Return whether an angle behind the gear, taken in rad, would turn further than the motor."""
    motors = [motor for motor in sensors if motor.location == MOTOR and motor.kind == "speed"]
    if not motors or sensor.location in (MOTOR, TWIST):
        return False
    motor = motors[0]
    unit = motor.unit or ("rpm" if motor.column.meaning.kind_word in RPM_WORDS else "rad/s")
    motor_angle = motor.revised(unit=unit).angle(dt)
    return abs(signals.ratio(motor_angle, sensor.values)) < MIN_GEAR
