"""The model and what is unknown of it: parameters, relations between them, noise levels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from bayesdrill.basics.entries import LARGEST, SMALLEST, strange
from bayesdrill.basics.formulas import Expression, RelationError
from bayesdrill.config import latex
from bayesdrill.config.resolve import quantities, rig, sensors
from bayesdrill.config.resolve.rig import NominalTable
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Collector, Place
from bayesdrill.inference.unknowns import ParameterSpace, Unknown
from bayesdrill.rig import models
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.composed import in_vain, lacking, with_all
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.sensors import Sensing

_TRIED = 4096  # draws from the priors, at which formulas are tried


def check_model(found: Collector, config: Config, model: Model) -> None:
    """Constants of another model would be given in vain."""
    vain = strange(("name", "model"), MODELS.usable(), type(model), config.model)
    for entry, message in vain.items():
        found.add(("model", entry), message)


def check_torque(
    found: Collector, config: Config, model: Model, sensing: Sensing | None
) -> dict[str, float | Unknown | None]:
    """What is missing has to have an inertia, and numbers that are its own: size and time, if any."""
    acts = sensors.latent_torque(config)
    if acts is None:
        return {}
    if sensing is not None and (said := sensors.refuse_latent_torque(model, acts, sensing)):
        found.add(("missing_torque",), said)
    return {
        name: found.run(("missing_torque", entry), sensors.latent_torque_number, config, entry)
        for name, entry in sensors.ENTRIES.items()
    }


def check_parameters(found: Collector, config: Config, model: Model, table: NominalTable) -> None:
    nominal = table.values
    for name in models.PARAMETERS:
        spec = config.parameters.get(name)
        place: Place = ("parameters", name)
        if spec is None:
            if name in model.parameters:
                found.add(
                    place,
                    f"missing; to hold it write {_usual(name, nominal)}a number",
                )
        elif name not in model.parameters:
            found.add(place, f"the model {model.name} has no {name}; {_way_out(name)}")
        elif spec == "nominal" and name not in nominal:
            found.add(place, f"{_no_table(name)}; give a number, or `nominal: {{{name}: ...}}`")
        elif isinstance(spec, numbers.ParameterPrior):
            if spec.relative and name not in nominal:
                way_out = f"`nominal: {{{name}: ...}}`, or leave out `relative:`"
                found.add(place, f"{_no_table(name)}, to be relative to; give {way_out}")
            else:
                _check_prior(found, name, spec, table)
    _check_added(found, config, model)


def _check_prior(
    found: Collector, name: str, spec: numbers.ParameterPrior, table: NominalTable
) -> None:
    place, most = ("parameters", name), models.PARAMETERS[name].at_most
    built = found.run(place, quantities.prior, spec, table.values.get(name))
    if built is None:
        return
    if built.high > most:
        reaches = "has no end" if math.isinf(built.high) else f"goes up to {built.high:.6g}"
        ends = f"such as {{prior: uniform, low: {0.5 * most:g}, high: {most:g}}}"
        found.add(place, f"the prior {reaches}, and {name} is at most {most:g}; let it end, {ends}")
        return
    found.run(place, quantities.start, spec, built, table.compared.get(name))


def _way_out(name: str) -> str:
    """For a parameter of another model."""
    every = {n: with_all(kind()) for n, kind in MODELS.usable().items()}
    having = [n for n, rig in every.items() if name in rig.parameters]
    return f"remove it, or take model.name: {' or '.join(having)}" if having else "remove it"


def _no_table(name: str) -> str:
    """With what is known of it."""
    typical = models.PARAMETERS[name].typical
    return f"no table has {name}" + (f" ({typical})" if typical else "")


def _check_added(found: Collector, config: Config, model: Model) -> None:
    """What is named means something, and nothing is said of what is not named."""
    said: set[str] = set()
    for name, missing in lacking(model).items():
        if name not in said:
            found.add(("parameters", name), in_vain(name, missing))
        said |= {*model.offers[name]}
    for section in ("nominal", "simulation"):
        given = getattr(config, section)
        for name in models.PARAMETERS:
            if name not in model.parameters and getattr(given, name, None) is not None:
                offered = name in model.offers
                why = "not named in `parameters:`" if offered else f"not of the model {model.name}"
                also = "; name it there, or remove this" if offered else "; remove this"
                found.add((section, name), f"{name} is {why}{also}")


def _usual(name: str, nominal: Mapping[str, float]) -> str:
    return f"`{name}: nominal` ({nominal[name]:g}) or " if name in nominal else ""


def check_relations(
    found: Collector, config: Config, model: Model, table: NominalTable
) -> ParameterSpace | None:
    """Ties, formulas, and the quantities in them; the rig's own space, where nothing is wrong."""
    before = len(found.problems)
    used: set[str] = set()
    for name, spec in config.quantities.items():
        given = found.run(("quantities", name), quantities.quantity, name, spec)
        if given is not None and getattr(spec, "latex", None) is not None:
            found.run(("quantities", name, "latex"), latex.check, given.symbol)
    for name, derived in config.derived.items():
        own = found.run(("derived", name), quantities.formula, config, model, name)
        if own is not None and derived.latex is not None:
            found.run(("derived", name, "latex"), latex.check, own.symbol)
        used |= set(own.expression.names) if own else set()
    relations = {
        name: found.run(("parameters", name), quantities.relation, config, model, name)
        for name in model.parameters
    }
    related = {name: r for name, r in relations.items() if r is not None}
    missing = any(config.parameters.get(name) is None for name in model.parameters)
    if missing or len(found.problems) > before:
        return None
    used |= {name for r in related.values() for name in r.names}
    for name in [n for n in config.quantities if n not in used]:
        message = "no formula names it; use it in `parameters:` or `derived:`, or remove it"
        found.add(("quantities", name), message)
    try:
        space = rig.space(config, model, table)
    except RelationError as error:
        found.add(("parameters", error.name), str(error))
        return None
    except ValueError:  # a prior or a start, said already
        return None
    _check_values(found, space, related)
    return space


def _check_values(
    found: Collector, space: ParameterSpace, related: Mapping[str, Expression]
) -> None:
    """What is computed for a parameter must be a positive number wherever the priors lead."""
    theta = space.draw(_TRIED, np.random.default_rng(0)) if space.free else np.ones((1, 0))
    named = space.named(theta)
    for name, relation in related.items():
        values = np.broadcast_to(named[name], len(theta))
        most = min(LARGEST, models.PARAMETERS[name].at_most)
        good = (values >= SMALLEST) & (values <= most)
        if not good.all():
            k = int(np.argmin(good))
            found.add(
                ("parameters", name),
                f"'{relation.text}' is {values[k]:.3g} at {100 * np.mean(~good):.3g} % of what the "
                f"priors allow, and must be positive (and at most {most:g}); mend the formula or "
                "narrow the priors",
            )


def free_parameters(config: Config, names: Iterable[str]) -> list[str]:
    """Those of `names` that have a prior."""
    given = config.parameters
    return [name for name in names if isinstance(given.get(name), numbers.ParameterPrior)]


def free_quantities(config: Config) -> list[str]:
    return [name for name, q in config.quantities.items() if isinstance(q, numbers.ParameterPrior)]
