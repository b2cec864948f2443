"""Build changes of a config that correct the factor of a wrong unit in one of its entries."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from bayesdrill.analysis.causes import SCALE
from bayesdrill.analysis.suspicions import FACTORS
from bayesdrill.basics import units
from bayesdrill.config.job import Job
from bayesdrill.selection.config_edits import Entries, Place, columns, merged, nested, rounded

OF_ALL = FACTORS[-1:]  # 1000 applies to all units, the other factors only to units of rotation
OF_ROTATION = ("rad", "N*m/A")  # parts of units in which rad may be confused with deg or rpm
# Keys of a prior whose numbers have the unit of the unknown.
KEYS = ("value", "low", "high", "median", "mean", "sd", "scale", "start")


def scale_entries(job: Job) -> Iterator[tuple[str, str, Entries]]:
    """Yield (name, words, lines) of each change that corrects the factor of a wrong unit."""
    symbols = job.problem.model.symbols
    for name in job.problem.model.parameters:
        if (given := _value(job, name)) is None:
            continue
        place, entry = given
        for label, factor in _factors(symbols[name].unit):
            for times in (1 / factor, factor):
                verb = "multiplied" if times > 1 else "divided"
                words = f"the value of {name} {verb} by {label} ({_location(job, place)})"
                yield f"{SCALE}{name}_{times:.3g}", words, nested(place, _scaled(entry, times))
    yield from _columns(job)


def _value(job: Job, name: str) -> tuple[Place, Any] | None:
    """Return place and entry of the number that sets a parameter; None if no number sets it."""
    data = job.source.data
    entry, nominal = (data.get("parameters") or {}).get(name), data.get("nominal")
    if entry == "nominal" or (isinstance(entry, dict) and entry.get("relative")):
        table = nominal if isinstance(nominal, dict) else {}
        known = {**job.problem.posterior.space.fixed, **job.problem.nominal, **table}
        return ("nominal", name), known[name]
    if isinstance(entry, int | float) or (isinstance(entry, dict) and {*KEYS} & {*entry}):
        return ("parameters", name), entry
    return None


def _columns(job: Job) -> Iterator[tuple[str, str, Entries]]:
    """Yield changes of the units of channels and inputs."""
    data, rig = job.source.data, job.problem.model
    experiments = [each.experiment for each in job.problem.observations]
    kinds = {c.name: c.unit for each in experiments for c in each.channels}
    kinds |= {name: rig.symbols[name].unit for name in rig.inputs}
    for name, kind in kinds.items():
        constants = (data.get("inputs") or {}).get(name)
        places: list[tuple[Place, Any]] = [*columns(data, name)]
        if isinstance(constants, int | float) and constants:
            places.append((("inputs", name), constants))
        for label, factor in _factors(kind) if places else ():
            for times in (1 / factor, factor):
                lines: Entries = {}
                for place, entry in places:
                    lines = merged(lines, _rescaled(place, entry, kind, times))
                verb = "multiplied" if times > 1 else "divided"
                words = f"the unit of {name} {verb} by {label} ({_location(job, places[0][0])})"
                yield f"{SCALE}{name}_{times:.3g}", words, lines


def _rescaled(path: Place, entry: Any, kind: str, times: float) -> Entries:
    """Return lines that multiply a column or constant by `times`, with another unit or a gain."""
    if not isinstance(entry, dict):
        return nested(path, rounded(entry * times, 9))
    given = units.factor(entry.get("unit", kind), kind)
    if other := units.unit_of_factor(kind, given * times):
        return nested((*path, "unit"), other)
    gain = entry.get("gain", 1.0)
    return {} if isinstance(gain, dict) else nested((*path, "gain"), rounded(gain / times, 9))


def _scaled(entry: Any, times: float) -> Any:
    if isinstance(entry, dict):
        numbers = {k: x for k, x in entry.items() if k in KEYS and isinstance(x, int | float)}
        return entry | {key: rounded(x * times, 9) for key, x in numbers.items()}
    return rounded(entry * times, 9)


def _factors(unit: str) -> Iterator[tuple[str, float]]:
    turning = any(part in unit for part in OF_ROTATION)
    return ((f"{factor:.4g}", factor) for factor, _ in (FACTORS if turning else OF_ALL))


def _location(job: Job, path: Place) -> str:
    """Return the file, line and entry at a place of the config."""
    return job.source.issue(path, "").place.removeprefix(f"{job.source.path.parent}/")
