"""Config to objects through the registries, and their assembly: simulators, noises, unknowns, a
`Problem`.

Config to objects, through the registries: the one place where names become things.

The single steps raise `ValueError` with a message for the user, and `consistency` runs them one
by one to collect all mistakes.  `assembling` puts everything together.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from dataclasses import replace

from bayesdrill.basics import symbols
from bayesdrill.basics.entries import made
from bayesdrill.basics.errors import InputError, of_each
from bayesdrill.basics.formulas import Expression, resolved
from bayesdrill.basics.registry import lookup
from bayesdrill.config.resolve import experiments, quantities, sensors
from bayesdrill.config.resolve.channel_noise import channels, noise
from bayesdrill.config.resolve.experiments import View, common_or_own, held_out
from bayesdrill.config.resolve.quantities import formula, prior, quantity, relation, start
from bayesdrill.config.resolve.sensors import Declared
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Asked, Config, Thresholds
from bayesdrill.config.yaml_source import Place
from bayesdrill.inference import step_error
from bayesdrill.inference.likelihood import Likelihood, Observation
from bayesdrill.inference.noise.mixed import of_record
from bayesdrill.inference.posterior import Posterior, Problem
from bayesdrill.inference.unknowns import ParameterSpace, Unknown, of_label
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig import models
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.composed import with_named
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.sampling.optimisers import OPTIMISERS
from bayesdrill.sampling.optimisers.contract import Optimiser

RUBBING_WALKERS = 96
WALKERS_OF_EXPERIMENT = 16  # more: it may bring unknowns of its own


def model(config: Config, more: Collection[str] = ()) -> Model:
    """With the constants that the config gives, as far as the model has them, and with what it offers of
    the parameters that the config names, or that are `more`.
    """
    rig = made(lookup(MODELS, config.model.name, "model"), config.model)
    given = config.parameters
    named = [name for name in models.PARAMETERS if getattr(given, name) is not None]
    return with_named(rig, {*named, *more})


def with_walkers(config: Config) -> Config:
    """Fewer by themselves where the rig rubs: a step of a walker is dear there, and its 256 would tell
    far more than is asked.
    """
    sampler = config.sampler
    if "walkers" in sampler.model_fields_set or not model(config).frictions:
        return config
    walkers = min(
        sampler.walkers, RUBBING_WALKERS + WALKERS_OF_EXPERIMENT * len(config.experiments)
    )
    fewer = sampler.model_copy(update={"walkers": walkers})
    return config.model_copy(update={"sampler": fewer})


def nominal(config: Config) -> dict[str, float]:
    """Nominal values of parameters: those of the table, unless the config says otherwise."""
    table = lookup(symbols.NOMINAL, _table(config), "nominal table")
    own = {name: getattr(config.nominal, name) for name in models.PARAMETERS}
    return {**table.values, **{name: value for name, value in own.items() if value is not None}}


def _table(config: Config) -> str:
    return config.nominal.table or symbols.DEFAULT_NOMINAL  # type: ignore[attr-defined]


def compared(config: Config) -> dict[str, float]:
    """Nominal values that are this rig's: all of a table that the config names or relies on.

    Where the config has values of its own, or no use for a table, the table speaks of another rig.
    """
    given, table = config.nominal, nominal(config)
    own = {name for name in table if getattr(given, name) is not None}
    used = {name for name in table if _refers(getattr(config.parameters, name))}
    if given.table is not None or (used and not own):  # type: ignore[attr-defined]
        return table
    return {name: value for name, value in table.items() if name in own | used}


def _refers(spec: object) -> bool:
    return spec == "nominal" or quantities.is_relative(spec)


def published_nominal(config: Config) -> list[str]:
    """Names whose nominal value is that of a table, not the config's own."""
    return [name for name in compared(config) if getattr(config.nominal, name) is None]


def nominal_tolerance(config: Config) -> dict[str, float]:
    """Of nominal values, relative, of all parameters."""
    given = config.nominal.tolerance  # type: ignore[attr-defined]
    if isinstance(given, float):
        return dict.fromkeys(models.PARAMETERS, given)
    own = {name: getattr(given, name) for name in models.PARAMETERS}
    return {name: given.default if value is None else value for name, value in own.items()}


def asked(config: Config) -> Asked:
    own = config.identify
    thresholds = Thresholds(determined=own.determined, left_to_prior=own.left_to_prior)
    return Asked(of_interest=tuple(own.of_interest), thresholds=thresholds, seed=config.seed)


def compared_with(config: Config) -> str:
    """What the nominal values are called in sentences."""
    whole = compared(config)
    own = [name for name in whole if getattr(config.nominal, name) is not None]
    if not own:
        return _table(config)
    if len(own) == len(whole):
        return "the config's nominal values"
    return f"{_table(config)} ({', '.join(own)} as in the config)"


def optimiser(config: Config) -> Optimiser:
    """How the MAP is searched."""
    return made(lookup(OPTIMISERS, config.map.method, "method"), config.map)


def initial_state(config: Config, model: Model) -> dict[str, float]:
    """What is held of it, SI; of a steady start only what is named."""
    initial = config.initial
    given = {name: getattr(initial, name) for name in model.outer}
    return {
        name: quantities.si(value, models.STATES[name].unit)
        for name, value in given.items()
        if isinstance(value, float | int | numbers.Quantity)
        and (initial.state != "steady" or name in initial.model_fields_set)
    }


def space(
    config: Config,
    model: Model,
    noise: Sequence[Unknown],
    told: Sequence[Declared] = (),
    labels: Sequence[str] = (),
) -> ParameterSpace:
    """The unknowns: free parameters in the model's order, quantities, sensors and starts as they are
    `told`, then those of the `noise`.  What is `own` is there once for each of the `labels`.
    """
    table, known = nominal(config), compared(config)
    unknowns: list[Unknown] = []
    fixed: dict[str, float] = {}
    relations: dict[str, Expression] = {}
    for name in model.parameters:
        spec = getattr(config.parameters, name)
        related = relation(config, model, name)
        if related is not None:
            relations[name] = related
        elif spec == "nominal":
            if name not in table:
                raise ValueError(f"no table has {name}")
            fixed[name] = table[name]
        elif isinstance(spec, float | int):
            fixed[name] = float(spec)
        else:
            built = prior(spec, table.get(name))
            begin = start(spec, built, known.get(name))
            one = Unknown(symbol=models.PARAMETERS[name], role="rig", prior=built, start=begin)
            several = labels if name in config.own else [""]
            unknowns += [one.of(label) for label in several]
    for name, given in ((n, quantity(n, spec)) for n, spec in config.quantities.items()):
        if isinstance(given.value, float):
            fixed[name] = given.value
        else:
            symbol, own = given.symbol, given.value
            unknowns.append(Unknown(symbol=symbol, role="quantity", prior=own, start=given.start))
    relations, free = resolved(relations), {unknown.name for unknown in unknowns}
    for name in [n for n, r in relations.items() if not set(r.names) & free]:
        fixed[name] = float(relations.pop(name).value(fixed))
    for each in told:
        if isinstance(each.value, float):
            fixed[each.name] = each.value
        else:
            unknowns.append(
                Unknown(symbol=each.symbol, role=each.role, prior=each.value, start=each.start)
            )
    rig = [n for n in dict.fromkeys(local_names(config, model, labels)) if n]
    return ParameterSpace(
        model=(*rig, *(each.name for each in told)),
        unknowns=(*unknowns, *noise),
        fixed=fixed,
        relations=relations,
    )


def local_names(config: Config, model: Model, labels: Sequence[str]) -> list[str]:
    """Of the rig's parameters, what is own once for each label."""
    return [
        of_label(name, label)
        for name in model.parameters
        for label in (labels if name in config.own else [""])
    ]


FEW = 4  # steps to a sample, for the search of the maximum: there they are chosen anew


def problem(config: Config, views: Sequence[View], experiments: Sequence[Experiment]) -> Problem:
    """Everything, for records already read (`reading.read`), one of each view of the config.

    Raises `InputError` where records and what is said of them do not go together.
    """
    rig = model(config)
    labels = [view.label for view in views]
    parts, told, levels = [], dict[str, Declared](), dict[str, Unknown]()
    pairs = zip(views, experiments, strict=True)
    made = of_each(lambda pair: _told_and_observation(pair[0], rig, pair[1]), pairs)
    for view, (own, observed) in zip(views, made, strict=True):
        renamed = {each.name: common_or_own(config, each.name, view.label) for each in own}
        for each in own:
            told.setdefault(renamed[each.name], each.of(view.label, renamed[each.name]))
        names = [common_or_own(config, unknown.name, view.label) for unknown in observed.unknowns]
        for name, unknown in zip(names, observed.unknowns, strict=True):
            levels.setdefault(name, unknown if name == unknown.name else unknown.of(view.label))
        of_rig = [of_label(n, view.label if n in config.own else "") for n in rig.parameters]
        of_sensors = [renamed[name] for name in observed.parameters[len(of_rig) :]]
        parts.append(replace(observed, parameters=[*of_rig, *of_sensors], levels=names))
    unknowns = space(config, rig, [*levels.values()], [*told.values()], labels)
    posterior = Posterior(
        space=unknowns,
        likelihood=Likelihood.joint(unknowns, parts).without(held_out(config)),
        coordinates=unknowns.coordinates(),
    )
    if config.model.pieces is None:
        posterior = step_error.chosen(posterior, unknowns.vector(unknowns.start), FEW)
    table, published = {**compared(config)}, published_nominal(config)
    tolerance = nominal_tolerance(config)
    for name, label in itertools.product(config.own, labels):
        if name in table:
            table[of_label(name, label)] = table[name]
        if name in published:
            published.append(of_label(name, label))
        tolerance[of_label(name, label)] = tolerance[name]
    return Problem(
        posterior=posterior,
        symbols=tuple(unknown.symbol for unknown in unknowns.unknowns),
        nominal=table,
        published=frozenset(published),
        tolerance=tolerance,
        derived=tuple(formula(config, rig, name) for name in config.derived),
    )


def _told_and_observation(
    view: View, model: Model, experiment: Experiment
) -> tuple[list[Declared], Observation]:
    response, told = simulated(view, model, experiment)
    return told, _observation(view, model, response)


def _observation(view: View, model: Model, response: Simulator) -> Observation:
    """One record with the noise of its channels, and what shakes it."""
    experiment = response.experiment
    found, place = noise(channels(view.config, model), len(experiment.t)), "record"
    try:
        found = of_record(found, experiment.t, experiment.seen)
        place = "missing_torque"
        return sensors.observation(view.config, response, found, view.label)
    except ValueError as error:
        raise InputError([view.source.problem((place,), str(error))]) from None


def _unsaid_motion(config: Config, model: Model, experiment: Experiment) -> str:
    """A window that begins in motion has to say how."""
    if config.record.window is None or config.initial.model_fields_set - {"time"}:
        return ""
    levels = [one.noisy for one in channels(config, model)]
    sigmas = [one.sigma if isinstance(one.sigma, float) else one.start for one in levels]
    motion = experiments.unsaid_motion(experiment, sigmas)
    if not motion or not experiment.series:
        return ""
    return (
        f"it begins in motion ({motion}), and the config says nothing of it; write `initial: free`, "
        "`initial: steady`, or the states there"
    )


def simulated(view: View, model: Model, experiment: Experiment) -> tuple[Simulator, list[Declared]]:
    """One experiment with its sensors and its start, and the numbers that are told of them."""
    entries = [*sensors.sensor_entries(view.config, model)]
    told = [sensors.sensor_specs(entry) for entry in entries]
    sensing, wrong = sensors.sensing(view.config, model), dict[Place, str]()
    for entry, each in zip(entries, told, strict=True):
        if entry.kind in ("lag", "delay") and (
            said := experiments.start_too_late(each, experiment)
        ):
            wrong[entry.place] = said
    for name in sensors.free_states(view.config, model):
        try:
            told.append(
                experiments.free_start(name, experiment, model, _at_start(view.config, model))
            )
        except ValueError as error:
            wrong["initial", name] = str(error)
    if said := _unsaid_motion(view.config, model, experiment):
        wrong["record", "window"] = said
    seen = experiment
    if not wrong:
        values = {each.name: each.value for each in told}
        seen = experiments.start_beyond_lags(experiment, sensing, values)
        wrong = _unseen(view, model, seen)
    if wrong:
        raise InputError([view.source.problem(place, said) for place, said in wrong.items()])
    return simulator(model, seen, sensing, view.config.model.pieces or 1), told


def _unseen(view: View, model: Model, experiment: Experiment) -> dict[Place, str]:
    """Channels of which the lags leave nothing."""
    late = [e for e in sensors.sensor_entries(view.config, model) if e.kind in ("lag", "delay")]
    delays = [e.place for e in late if e.place[0] == "inputs"]
    hidden: dict[Place, list[str]] = {}
    for name, left in zip(experiment.names, experiment.counts, strict=True):
        if left < 2:
            own: Place = ("record", "channels", name, "lag")
            hidden.setdefault(delays[0] if delays else own, []).append(name)
    return {
        place: "the rig moves at the start, and with so large a lag no sample of "
        f"{', '.join(names)} is sure to be later; give the lag a prior with a smaller end"
        for place, names in hidden.items()
    }


def _at_start(config: Config, model: Model) -> dict[str, float]:
    """The rig's parameters where searches begin."""
    known = space(config, model, [])
    values = {**known.fixed, **known.start}
    values |= {name: float(r.value(values)) for name, r in known.relations.items()}
    return {name: values[name] for name in model.parameters}
