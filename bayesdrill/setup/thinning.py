"""An experiment with one sample of several, on request only."""

from __future__ import annotations

import dataclasses

import numpy as np

from bayesdrill.record import decimation
from bayesdrill.record.experiment import Experiment, frozen

LEFT = 10  # samples


def refusal(experiment: Experiment, factor: int, *, filtered: bool) -> str:
    """Why it cannot be thinned, and what to do; empty where it can."""
    rows = len(experiment.t)
    if not filtered:
        fewest, need = min(experiment.counts), (LEFT - 1) * factor + 1
        return _too_few(fewest, need) if fewest < need else ""
    if not experiment.uniform:
        return (
            "a filter needs equal time steps, and these are not; remove it, say `filter: false`, "
            "or cut the record at gaps"
        )
    if not experiment.seen.all():
        k = int(np.argmin(experiment.counts))
        return (
            f"a filter needs every sample, and {rows - experiment.counts[k]} of {experiment.names[k]} "
            "are missing, masked or outside the windows; remove it, say `filter: false`, or name one "
            "window without them"
        )
    need = decimation.length(factor) + (LEFT - 1) * factor
    return _too_few(rows, need) if rows < need else ""


def _too_few(there: int, need: int) -> str:
    return f"{there} samples are too few: {need} leave {LEFT}; take a smaller factor"


def thinned(experiment: Experiment, factor: int) -> Experiment:
    """Channels filtered, and one sample of `factor` left.

    Inputs that are measured stay as they are at every time, as the rig follows each of their steps:
    between samples that are left, channels are not measured.
    """
    dt, names = experiment.dt, experiment.names
    found = decimation.thinned(experiment.y, factor)
    if experiment.series:
        t, y = experiment.t, np.full_like(experiment.y, np.nan)
        y[found.kept] = found.y
    else:
        t, y = experiment.t[found.kept], found.y
    taps, half = decimation.length(factor), decimation.cutoff(factor, dt)
    taken = ", ".join(
        f"{sd:.3g} {one.unit} of {one.name}"
        for sd, one in zip(found.taken, experiment.channels, strict=True)
    )
    told = (
        f"{', '.join(names)}: filtered and decimated, one sample of {factor} is left "
        f"({len(found.kept)} of {len(experiment.t)}); the filter is a zero-phase FIR of {taps} samples, "
        f"half of the amplitude at {half:.6g} Hz, and {taps // 2} samples at either end are dropped; it "
        f"took away (sd) {taken}; sigma is the noise of what is left; the model is not filtered"
    )
    return dataclasses.replace(experiment, t=frozen(t), y=frozen(y), told=(*experiment.told, told))


def left(experiment: Experiment, factor: int) -> Experiment:
    """As they are: of each channel its first sample, and then one of `factor`."""
    seen = experiment.seen
    taken = seen & ((np.cumsum(seen, axis=0) - 1) % factor == 0)
    t, y = experiment.t, np.where(taken, experiment.y, np.nan)
    held = experiment.held_out
    if not experiment.series and held is None:
        rows = taken.any(axis=1)
        t, y = t[rows], y[rows]
    counts = ", ".join(
        f"{np.count_nonzero(taken[:, k])} of {np.count_nonzero(seen[:, k])} of {name}"
        for k, name in enumerate(experiment.names)
    )
    told = (
        f"decimated without a filter: one sample of {factor} is left ({counts}), as it was measured; "
        "what is faster than half the new rate stays in it, and sigma is the noise of a single sample"
    )
    return dataclasses.replace(experiment, t=frozen(t), y=frozen(y), told=(*experiment.told, told))
