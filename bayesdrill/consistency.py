"""What must hold between the entries of a config, each broken rule as a problem with its place."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from bayesdrill import beliefs, build, givens, symbols, units
from bayesdrill import config as records
from bayesdrill.errors import Problem, did_you_mean
from bayesdrill.expressions import linear_combination
from bayesdrill.formulas import CircleError, Expression
from bayesdrill.models import MODELS, constants
from bayesdrill.models.linear import Model
from bayesdrill.optimisers import OPTIMISERS
from bayesdrill.parameters import ParameterSpace
from bayesdrill.samplers.moves import MOVES
from bayesdrill.yaml_source import Place, Source

_TRIED = 4096  # draws from the priors, at which formulas are tried


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
        _check_model(found, config, model)
        if nominal is not None:
            _check_parameters(found, config, model, nominal)
            _check_relations(found, config, model)
        _check_channels(found, config, model)
        _check_counts(found, config, model)
        _check_map(found, config, model)
        _check_states(found, config, model)
        _check_output(found, config, model)
    _check_record(found, config)
    _check_inputs(found, config)
    _check_simulation(found, config)
    _check_calibration(found, config)
    _check_identify(found, config)
    return found.problems


def _check_model(found: _Collector, config: records.Config, model: Model) -> None:
    """Constants of another model would be given in vain."""
    for name, value in config.model:
        having = [other for other, kind in MODELS.items() if name in (*constants(kind), "name")]
        if value is not None and model.name not in having:
            found.add(
                ("model", name),
                f"the model {model.name} has no {name}; remove it, or name: {' or '.join(having)}",
            )


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
        elif isinstance(spec, beliefs.PriorBase):
            built = found.run(place, givens.prior, spec, nominal[name])
            if built is not None:
                found.run(place, givens.start, spec, built, nominal[name])


def _check_relations(found: _Collector, config: records.Config, model: Model) -> None:
    """Ties, formulas, and the quantities in them."""
    before = len(found.problems)
    used: set[str] = set()
    for name, spec in config.quantities.items():
        found.run(("quantities", name), givens.quantity, name, spec)
    for name in config.derived:
        own = found.run(("derived", name), givens.formula, config, model, name)
        used |= set(own.expression.names) if own else set()
    relations = {
        name: found.run(("parameters", name), givens.relation, config, model, name)
        for name in model.parameters
    }
    related = {name: r for name, r in relations.items() if r is not None}
    missing = any(getattr(config.parameters, name) is None for name in model.parameters)
    if missing or len(found.problems) > before:
        return
    used |= {name for r in related.values() for name in r.names}
    for name in set(config.quantities) - used:
        message = "no formula names it; use it in `parameters:` or `derived:`, or remove it"
        found.add(("quantities", name), message)
    try:
        space = build.space(config, model, [])
    except CircleError as circle:
        found.add(("parameters", circle.name), str(circle))
        return
    except ValueError:  # a prior or a start, said already
        return
    _check_values(found, space, related)


def _check_values(
    found: _Collector, space: ParameterSpace, related: Mapping[str, Expression]
) -> None:
    """What is computed for a parameter must be a positive number wherever the priors lead."""
    theta = space.draw(_TRIED, np.random.default_rng(0)) if space.free else np.ones((1, 0))
    named = space.named(theta)
    for name, relation in related.items():
        values = np.broadcast_to(named[name], len(theta))
        good = np.isfinite(values) & (values > 0)
        if not good.all():
            k = int(np.argmin(good))
            found.add(
                ("parameters", name),
                f"'{relation.text}' is {values[k]:.3g} at {100 * np.mean(~good):.3g} % of what the "
                "priors allow, and must be positive; mend the formula or narrow the priors",
            )


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
    found: _Collector, place: Place, value: float | beliefs.Quantity, unit: str
) -> None:
    if isinstance(value, beliefs.Quantity):
        found.run((*place, "unit"), units.factor, value.unit, unit)


def _free(config: records.Config, model: Model) -> list[str]:
    """Parameters and quantities with a prior."""
    free = [
        name
        for name in model.parameters
        if isinstance(getattr(config.parameters, name), beliefs.PriorBase)
    ]
    return free + [n for n, q in config.quantities.items() if isinstance(q, beliefs.PriorBase)]


def _sigmas(config: records.Config) -> list[str]:
    """Unknown noise levels."""
    return [
        f"sigma_{name}"
        for name, channel in config.record.channels.items()
        if isinstance(channel.sigma, beliefs.PriorBase)
    ]


def _check_map(found: _Collector, config: records.Config, model: Model) -> None:
    if found.run(("map", "method"), build.lookup, OPTIMISERS, config.map.method, "method") is None:
        return
    given = next((name for name in build.PAIRWISE if getattr(config.map, name) is not None), None)
    unknown = [*_free(config, model), *_sigmas(config)]
    found.run(("map", given or "method"), build.optimiser, config, unknown)


def _check_counts(found: _Collector, config: records.Config, model: Model) -> None:
    """Unknowns against walkers, moves and coordinates."""
    free = _free(config, model)
    n_unknown = len(free) + len(_sigmas(config))
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


def _check_calibration(found: _Collector, config: records.Config) -> None:
    """What the pilot and the ranks need."""
    own = config.calibration
    if own.max_steps <= config.sampler.pilot:
        message = f"{own.max_steps} is not above the pilot's {config.sampler.pilot}; make it larger"
        found.add(("calibration", "max_steps"), message)
    if own.ess < own.draws:
        message = (
            f"{own.ess:g} effective draws do not hold {own.draws} independent ones; make it larger"
        )
        found.add(("calibration", "ess"), message)


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
    for name in simulation.quantities:
        if name not in config.quantities and not found.spoilt(("quantities", name)):
            hint = did_you_mean(name, config.quantities)
            found.add(("simulation", "quantities", name), f"there is no such quantity{hint}")


def _check_output(found: _Collector, config: records.Config, model: Model) -> None:
    """Names that a corner plot can show: unknowns, what is tied, what is derived."""
    shown = [
        name
        for name in model.parameters
        if isinstance(getattr(config.parameters, name), beliefs.PriorBase | beliefs.Tie)
        or givens.is_formula(getattr(config.parameters, name))
    ]
    shown += [name for name, q in config.quantities.items() if isinstance(q, beliefs.PriorBase)]
    shown += [*_sigmas(config), *symbols.DERIVED, *config.derived]
    for k, name in enumerate(config.output.corner or ()):
        if name not in shown:
            hint = did_you_mean(name, shown)
            found.add(("output", "corner", k), f"{name} is neither unknown nor derived{hint}")


def _check_identify(found: _Collector, config: records.Config) -> None:
    own = config.identify
    unknown = [
        name
        for name in symbols.PARAMETERS
        if isinstance(getattr(config.parameters, name), beliefs.PriorBase)
    ]
    for k, name in enumerate(own.of_interest):
        if name not in unknown:
            hint = did_you_mean(name, unknown)
            found.add(("identify", "of_interest", k), f"{name} is no unknown parameter{hint}")
    if own.determined > own.left_to_prior:
        message = f"{own.determined:g} is above left_to_prior, {own.left_to_prior:g}; exchange them"
        found.add(("identify", "determined"), message)
