"""Report quantities that follow from the unknowns."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import plain
from bayesdrill.inference.derived import Derived, DerivedRow, values_at
from bayesdrill.inference.display_units import DisplayedUnknowns
from bayesdrill.inference.posterior import Problem
from bayesdrill.report.section import (
    HDI,
    Note,
    Picture,
    Section,
    Table,
    build,
    records_as_csv,
    table_of,
)
from bayesdrill.report.view import ReportContext, ReportPart


def derived_csv(rows: Sequence[DerivedRow]) -> str:
    """Return the rows as CSV in SI; `share` is the fraction of draws that have the quantity."""
    return records_as_csv(DerivedRow, rows)


def derived_table(rows: Sequence[DerivedRow], meanings: Mapping[str, str]) -> Table:
    """Build the table of derived quantities, with their meanings."""

    def cells(row: DerivedRow) -> dict[str, str]:
        part = "" if row.share == 1.0 else f"; {100 * (1 - row.share):.2g} % of the draws have none"
        ratio = abs(row.mean) / row.sd if row.sd > 0 else 1.0
        digits = max(4, min(12, 2 + math.ceil(math.log10(max(ratio, 1.0)))))  # two digits of the sd
        return {
            "": row.name,
            "unit": plain(row.unit),
            "nominal": "" if row.nominal is None else f"{row.nominal:.4g}",
            "mean": f"{row.mean:.{digits}g}",
            "sd": f"{row.sd:.2g}",
            HDI: f"{row.hdi_low:.{digits}g} to {row.hdi_high:.{digits}g}",
            "dev. %": "" if row.deviation is None else f"{100 * row.deviation:+.2f}",
            "meaning": meanings[row.name] + part,
        }

    return table_of(map(cells, rows), "", "unit", "meaning").filled()


def derived_shown(
    problem: Problem, names: Sequence[str] | None, draws: Array, derived: Derived, theta: Array
) -> tuple[Array, DisplayedUnknowns]:
    """Return draws `(N, D)` of `names` (None: all unknowns) in display units, and how to show them.

    A name is of an unknown, in `draws (E, N, D)`, or of a derived quantity. `theta (1, D)` is the
    MAP. Draws without a value, and quantities that are constant, are left out.
    """
    symbols, units = (*problem.symbols, *derived.symbols), problem.units
    order = [symbol.name for symbol in symbols]
    every = np.concatenate([draws, derived.values], axis=-1).reshape(-1, len(order))
    mode = {name: float(x) for name, x in zip(problem.names, theta[0], strict=True)}
    at_map = values_at(problem, theta).items()
    mode |= {name: float(x[0]) for name, x in at_map if np.isfinite(x[0])}
    wanted = problem.names if names is None else dict.fromkeys(names)
    columns = [order.index(name) for name in wanted if name in order]
    columns = [k for k in columns if len(np.unique(every[np.isfinite(every[:, k]), k])) > 1]
    if not columns:
        return derived_shown(problem, None, draws, derived, theta)
    nominal = {name: x for name, x in derived.nominal.items() if np.isfinite(x)}
    shown = DisplayedUnknowns(
        columns=tuple(columns),
        factors=units.factors(symbols[k] for k in columns),
        symbols=units.symbols(symbols[k] for k in columns),
        priors=units.priors(problem.posterior.space.priors),
        nominal=units.values({**nominal, **problem.nominal}),
        mode=units.values(mode),
    )
    picked = every[:, columns] / shown.factors
    return picked[np.isfinite(picked).all(axis=1)], shown


def _sections(run: ReportContext, _: Sequence[Picture]) -> Iterator[Section]:
    rows, meanings = run.units.rows(run.analysis.derived), run.analysis.meanings
    follows = derived_table(rows, meanings) if rows else Note("none")
    yield build("What follows from these", follows, brief=False)


PART = ReportPart(
    sections=_sections,
    files={"derived.csv": lambda run: derived_csv(run.analysis.derived)},
)
