"""Intervals on the range of their priors, as bars beside a table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from bayesdrill.inference.priors import Prior, flat_in_logs
from bayesdrill.insight.diagnostics import Row
from bayesdrill.report.sections import Bar

TAIL = 0.001  # of a prior, outside of the range
DECADES = 1.5  # from which on a range that is flat in logs is drawn so


def bars(rows: Sequence[Row], priors: Mapping[str, Prior]) -> tuple[Bar, ...]:
    return tuple(_bar(row, priors[row.name]) for row in rows)


def _bar(row: Row, prior: Prior) -> Bar:
    shown = [row.hdi_low, row.hdi_high, row.map]
    ends = [float(x) for x in prior.quantile(np.array([TAIL, 1 - TAIL]))]
    every = [*shown, *ends, *([] if row.nominal is None else [row.nominal])]
    low, high = min(every), max(every)
    logs = flat_in_logs(prior) and low > 0 and math.log10(high / low) > DECADES

    def share(x: float) -> float:
        if logs:
            return math.log(x / low) / math.log(high / low)
        return (x - low) / (high - low) if high > low else 0.5

    nominal = None if row.nominal is None else share(row.nominal)
    return Bar(share(row.hdi_low), share(row.hdi_high), nominal, share(row.map))
