"""The rig of a config: its model, its nominal values, and the space of its unknowns.

The steps raise `ValueError` with a message for the user.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from bayesdrill.basics.entries import made
from bayesdrill.basics.formulas import Expression, resolved
from bayesdrill.basics.registry import lookup
from bayesdrill.config.resolve import quantities
from bayesdrill.config.resolve.quantities import Declared
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.inference.posterior import Formula
from bayesdrill.inference.unknowns import ParameterSpace, Unknown, of_label
from bayesdrill.rig import models
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.composed import with_named
from bayesdrill.rig.models.linear import Model


def model(config: Config, more: Collection[str] = ()) -> Model:
    """With the constants that the config gives, as far as the model has them, and with what it offers of
    the parameters that the config names, or that are `more`.
    """
    rig = made(lookup(MODELS, config.model.name, "model"), config.model)
    named = {name for name, spec in config.parameters.items() if spec is not None}
    return with_named(rig, {*named, *more})


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


@dataclass(frozen=True, slots=True, kw_only=True)
class RigNumbers:
    """Numbers of the rig's `parameters`, in the model's order, or by what they follow from others, of
    quantities, and what is derived of them.
    """

    parameters: Mapping[str, Declared | Expression]
    quantities: Mapping[str, Declared]
    derived: tuple[Formula, ...]

    def space(
        self,
        own: Sequence[str] = (),
        labels: Sequence[str] = (),
        told: Sequence[Declared] = (),
        noise: Sequence[Unknown] = (),
    ) -> ParameterSpace:
        """The unknowns: free parameters, quantities, sensors and starts as they are `told`, then those
        of the `noise`.  What is `own` is there once for each of the `labels`.  Raises `RelationError`.
        """
        unknowns: list[Unknown] = []
        fixed: dict[str, float] = {}
        model: list[str] = []

        def add(each: Declared, several: Sequence[str] = ("",)) -> None:
            if isinstance(each.value, float):
                fixed[each.name] = each.value
                return
            one = Unknown(symbol=each.symbol, role=each.role, prior=each.value, start=each.start)
            unknowns.extend(one.of(label) for label in several)

        for name, each in self.parameters.items():
            several = labels if name in own else [""]
            model += [of_label(name, label) for label in several]
            if isinstance(each, Declared):
                add(each, several)
        for each in self.quantities.values():
            add(each)
        free = {unknown.name for unknown in unknowns}
        every = self.parameters.items()
        relations = resolved({name: x for name, x in every if isinstance(x, Expression)})
        for name in [n for n, r in relations.items() if not set(r.names) & free]:
            fixed[name] = float(relations.pop(name).value(fixed))
        for each in told:
            add(each)
        return ParameterSpace(
            model=(*model, *(each.name for each in told)),
            unknowns=(*unknowns, *noise),
            fixed=fixed,
            relations=relations,
        )
