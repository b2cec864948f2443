"""An experiment with one sample of several, on request only."""

from __future__ import annotations

import dataclasses

import numpy as np

from bayesdrill.record import decimation
from bayesdrill.record.experiment import Experiment, frozen

LEFT = 10  # samples


def refusal(experiment: Experiment, factor: int) -> str:
    """Why it cannot be thinned, and what to do; empty where it can."""
    rows = len(experiment.t)
    if not experiment.uniform:
        return "a filter needs equal time steps, and these are not; remove it, or cut the record at gaps"
    if not experiment.seen.all():
        k = int(np.argmin(experiment.counts))
        return (
            f"a filter needs every sample, and {rows - experiment.counts[k]} of {experiment.names[k]} "
            "are missing, masked or outside the windows; remove it, or name one window without them"
        )
    need = decimation.length(factor) + (LEFT - 1) * factor
    if rows < need:
        return f"{rows} samples are too few: {need} leave {LEFT}; take a smaller factor"
    return ""


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
