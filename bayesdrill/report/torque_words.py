"""The missing torque in words, as a table, and as data."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from bayesdrill.insight.shaking import Shaking
from bayesdrill.report.sections import Table

WHERE = {"motor": "at the motor (on its own side of the gear)", "rotor_1": "at rotor 1"}
HEADS = ("channel", "left without it", "left with it", "moved by it")
READ = (
    "Root mean squares over the spread of the channel, at the mean of the draws. *left with it*: what "
    "remains when all samples have said what the torque was, which is the noise of the sensor where the "
    "model is right; *moved by it*: its share of the motion. `torque.csv` has it sample by sample, and "
    "the figure `torque` shows it."
)


def sentence(found: Shaking) -> str:
    of = f" in {found.label}" if found.label else ""
    low, high = np.quantile(found.expected, (0.03, 0.97))
    width = np.mean(found.band[1] - found.band[0]) / 2
    sure = np.mean((found.band[0] > 0) | (found.band[1] < 0))
    return (
        f"missing torque{of}: {WHERE[found.at]} {low:.3g} to {high:.3g} N m in 94 % of the samples, "
        f"each known to {width:.2g} N m; its sign is sure in {100 * sure:.0f} % of the samples"
    )


def table(found: Shaking) -> Table:
    lines = [
        (
            one.channel,
            *(f"{100 * x / one.spread:.3g} %" for x in (one.without, one.left, one.moved)),
        )
        for one in found.courses
    ]
    return Table(HEADS, tuple(lines), frozenset(HEADS[:1]))


def as_csv(every: Sequence[Shaking]) -> str | None:
    """SI, a line for each sample; None where no torque is missing."""
    if not every:
        return None
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    names = list(dict.fromkeys(n for one in every for n in (*one.states, *one.inputs)))
    writer.writerow(["experiment", "t", "torque", "sd", "low", "high", *names])
    for one in every:
        sds, (low, high) = one.draws.std(axis=0), one.band
        columns = [one.states.get(n, one.inputs.get(n)) for n in names]
        for k, t in enumerate(one.t):
            row = [one.label, t, one.expected[k], sds[k], low[k], high[k]]
            writer.writerow([*row, *("" if c is None else c[k] for c in columns)])
    return out.getvalue()


def as_data(every: Sequence[Shaking]) -> list[dict[str, Any]]:
    """For `run.json`."""
    return [
        {
            "experiment": one.label,
            "at": one.at,
            "rms": float(np.sqrt(np.mean(one.expected**2))),
            "sd": float(one.draws.std(axis=0).mean()),
            "channels": {
                c.channel: {
                    "without": c.without / c.spread,
                    "with": c.left / c.spread,
                    "moved": c.share,
                }
                for c in one.courses
            },
        }
        for one in every
    ]
