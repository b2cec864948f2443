"""Rows of several runs as people are shown them: in the user's units, on axes that suit the priors."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from bayesdrill.inference.priors import flat_in_logs
from bayesdrill.insight.overlay import Layer, Place, Row
from bayesdrill.setup.own_units import OwnUnits


def shown(row: Row, own: OwnUnits) -> Row:
    """In the unit that its symbol then has."""
    factor = own.factor(row.symbol.name)
    if factor == 1.0:
        return dataclasses.replace(row, symbol=own.symbol(row.symbol))
    return dataclasses.replace(
        row,
        symbol=own.symbol(row.symbol),
        places=tuple(None if place is None else _over(place, factor) for place in row.places),
        nominal=tuple(None if value is None else value / factor for value in row.nominal),
    )


def _over(place: Place, factor: float) -> Place:
    return Place(
        mean=place.mean / factor,
        sd=place.sd / factor,
        low=place.low / factor,
        high=place.high / factor,
    )


def in_logs(row: Row, layers: Sequence[Layer]) -> bool:
    """Whether the prior of the first run that has this unknown is flat in its log."""
    found = (
        layer.problem.posterior.space.priors.get(row.symbol.name)
        for layer in layers
        if row.symbol in layer.problem.symbols
    )
    return flat_in_logs(next(found, None))
