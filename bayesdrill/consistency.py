"""What must hold between the entries of a config, each broken rule as a problem with its place."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bayesdrill import build, symbols, units
from bayesdrill import config as records
from bayesdrill.errors import Problem, did_you_mean
from bayesdrill.expressions import linear_combination
from bayesdrill.models.linear import Model
from bayesdrill.optimisers import OPTIMISERS
from bayesdrill.samplers.moves import MOVES
from bayesdrill.yaml_source import Place, Source


class _Collector:
    """Runs steps that raise `ValueError` for the user, and files their messages under a place."""

    def __init__(self, source: Source, spoilt: frozenset[Place]) -> None:
        self.problems: list[Problem] = []
        self.source = source
        self._spoilt = spoilt

    def add(self, place: Place, message: str) -> None:
        if not self.spoilt(place):
            self.problems.append(self.source.problem(place, message))

    def spoilt(self, place: Place) -> bool:
        """Whether something was said already of this entry, of one in it, or of one around it."""
        return any(self._touches(place, other) for other in self._spoilt)

    def run[T](self, place: Place, step: Callable[..., T], *arguments: Any) -> T | None:
        try:
            return step(*arguments)
        except ValueError as error:
            self.add(place, str(error))
            return None

    @staticmethod
    def _touches(place: Place, other: Place) -> bool:
        shared = min(len(place), len(other))
        return place[:shared] == other[:shared]


def check(config: records.Config, source: Source, spoilt: frozenset[Place]) -> list[Problem]:
    """Problems of a config whose entries are each valid; `spoilt` places were reported already."""
    found = _Collector(source, spoilt)
    model = found.run(("model", "name"), build.model, config)
    nominal = found.run(("nominal", "table"), build.nominal, config)
    if model is not None:
        if nominal is not None:
            _check_parameters(found, config, model, nominal)
        _check_channels(found, config, model)
        _check_counts(found, config, model)
        _check_states(found, config, model)
    _check_record(found, config)
    _check_inputs(found, config)
    _check_simulation(found, config)
    found.run(("map", "method"), build.lookup, OPTIMISERS, config.map.method, "method")
    return found.problems


def _check_parameters(
    found: _Collector, config: records.Config, model: Model, nominal: dict[str, float]
) -> None:
    for name in symbols.PARAMETERS:
        spec = getattr(config.parameters, name)
        place: Place = ("parameters", name)
        if spec is None:
            if name in model.parameters:
                found.add(
                    place,
                    f"missing; to hold it write `{name}: nominal` ({nominal[name]:g}) or a number",
                )
        elif name not in model.parameters:
            found.add(place, f"the model {model.name} has no such parameter; remove it")
        elif isinstance(spec, records.PriorBase):
            built = found.run(place, build.prior, spec, nominal[name])
            if built is not None:
                found.run(place, build.start, spec, built, nominal[name])


def _check_channels(found: _Collector, config: records.Config, model: Model) -> None:
    for name, spec in config.record.channels.items():
        place: Place = ("record", "channels", name)
        _check_measured(found, place, spec, model)
        _check_address(found, place, spec)


def _check_measured(
    found: _Collector, place: Place, spec: records.ChannelSpec, model: Model
) -> None:
    """Entry by entry, so that each mistake has the line where it stands."""
    before = len(found.problems)
    combines = {str(place[-1]): 1.0}
    if spec.measures is not None:
        text, at = spec.measures, (*place, "measures")
        combines = found.run(at, linear_combination, text, model.states) or {}
    states = [symbols.STATES[state] for state in combines if state in model.states]
    if states:
        found.run((*place, "unit"), units.factor, spec.unit, states[0].unit)
    known = spec.model_copy(update={"sigma": 1.0})
    if len(found.problems) == before:
        found.run(place, build.measured, place[-1], known, model.states)
    if len(found.problems) == before:
        found.run((*place, "sigma"), build.measured, place[-1], spec, model.states)


def _check_address(found: _Collector, place: Place, spec: records.Column) -> None:
    if spec.column is None and spec.variable is None:
        found.add(place, "neither `column:` nor `variable:` says where the numbers stand")


def _check_record(found: _Collector, config: records.Config) -> None:
    time = config.record.time
    if isinstance(time, records.TimeColumn):
        found.run(("record", "time", "unit"), units.factor, time.unit, "s")
        _check_address(found, ("record", "time"), time)
    window = config.record.window
    if window is not None and not window[0] < window[1]:
        found.add(("record", "window"), f"{window[0]:g} s is not before {window[1]:g} s")


def _check_inputs(found: _Collector, config: records.Config) -> None:
    holds = set()
    for name, symbol in symbols.INPUTS.items():
        spec = getattr(config.inputs, name)
        place: Place = ("inputs", name)
        if isinstance(spec, records.InputColumn):
            holds.add(spec.hold)
            found.run((*place, "unit"), units.factor, spec.unit, symbol.unit)
            _check_address(found, place, spec)
        else:
            _check_quantity(found, place, spec, symbol.unit)
    if len(holds) > 1:
        found.add(("inputs",), "all measured inputs need the same `hold:`")
    if holds and config.initial.time is not None:
        found.add(
            ("initial", "time"),
            "with measured inputs the initial state is that of the first sample; remove this entry",
        )


def _check_states(found: _Collector, config: records.Config, model: Model) -> None:
    for name in model.states:
        value = getattr(config.initial, name)
        _check_quantity(found, ("initial", name), value, symbols.STATES[name].unit)


def _check_quantity(
    found: _Collector, place: Place, value: float | records.Quantity, unit: str
) -> None:
    if isinstance(value, records.Quantity):
        found.run((*place, "unit"), units.factor, value.unit, unit)


def _check_counts(found: _Collector, config: records.Config, model: Model) -> None:
    """Unknowns against walkers, moves and coordinates."""
    free = [
        name
        for name in model.parameters
        if isinstance(getattr(config.parameters, name), records.PriorBase)
    ]
    sigmas = [c for c in config.record.channels.values() if isinstance(c.sigma, records.PriorBase)]
    n_unknown = len(free) + len(sigmas)
    sampler = config.sampler
    if n_unknown == 0:
        found.add(("parameters",), "nothing is unknown; give at least one parameter a prior")
    if sampler.walkers % 2 or sampler.walkers < 2 * n_unknown:
        found.add(
            ("sampler", "walkers"),
            f"{sampler.walkers} walkers: an even number, at least twice the {n_unknown} unknowns, is "
            "wanted",
        )
    if config.coordinates == "modal" and not free:
        found.add(("coordinates",), "modal coordinates need a free parameter; write `auto`")
    for name in sampler.moves:
        found.run(("sampler", "moves", name), build.lookup, MOVES, name, "move")
    if sum(weight for name, weight in sampler.moves.items() if name != "independence") <= 0:
        message = "no move is left for the pilot; give differential_evolution or stretch a share"
        found.add(("sampler", "moves"), message)
    if sampler.max_steps <= sampler.pilot:
        message = f"{sampler.max_steps} is not above the pilot's {sampler.pilot}; make it larger"
        found.add(("sampler", "max_steps"), message)


def _check_simulation(found: _Collector, config: records.Config) -> None:
    simulation: Any = config.simulation
    if simulation is None:
        return
    if (simulation.duration is None) != (simulation.rate is None):
        found.add(("simulation",), "`duration:` and `rate:` belong together; give both or neither")
    if simulation.duration is not None and simulation.duration * simulation.rate < 1:
        found.add(
            ("simulation", "duration"), "the record would have one sample only; make it longer"
        )
    for name in simulation.sigma:
        if name not in config.record.channels and not found.spoilt(("record", "channels", name)):
            hint = did_you_mean(name, config.record.channels)
            found.add(("simulation", "sigma", name), f"there is no such channel{hint}")
