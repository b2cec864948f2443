"""Choose where a record is studied before anything is searched: at the start, if the rig moves there.

Where friction holds a rig, or nothing sets it in motion, its signals depend on next to nothing, and
all would be left to the prior on that ground alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array
from bayesdrill.inference.compression import excerpt
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.inference.unknowns import labelled_name

DRAWS = 128  # from the priors, of which the best that moves is taken ...
TRIED = 16  # ... if it is among these
STILL = 1e-3  # of what a channel does in the record: a model that does no more stands still
MIN_MOTION_OVER_NOISE = 3.0  # sd of a channel over that of its noise, as neighbours tell it


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyPoint:
    """A physical point `theta (D,)` to study a record at, and what it is called in sentences.

    `still`: channels that the model does not move at the start, though the record moves them; `moves`:
    whether it moves them at `theta`.
    """

    theta: Array
    at: str
    still: tuple[str, ...] = ()
    moves: bool = True


def study_point(sensitivity: SensitivityStudy, posterior: Posterior, seed: int) -> StudyPoint:
    """Return the start or, where the rig stands still there, a likely draw of the priors that moves."""
    short, space = excerpt(posterior) or posterior, posterior.space
    start = space.vector(space.start)
    still = tuple(_still_channels(sensitivity.likelihood, start))
    if not still:
        return StudyPoint(theta=start, at="the start")
    drawn = space.draw(DRAWS, seeds.stream(seed, "identify", 2))
    densities = short.density(drawn)
    for k in np.argsort(-densities, kind="stable")[:TRIED]:
        if np.isfinite(densities[k]) and not [*_still_channels(sensitivity.likelihood, drawn[k])]:
            name = f"the best of {DRAWS} draws from the priors"
            return StudyPoint(theta=drawn[k], at=name, still=still)
    return StudyPoint(theta=start, at="the start", still=still, moves=False)


def _still_channels(likelihood: Likelihood, theta: Array) -> Iterator[str]:
    """Yield the channels that stand still at `theta (D,)`, of those that the record moves."""
    full = likelihood.space.full(theta[None])
    for observation in likelihood.observations:
        experiment = observation.experiment
        with np.errstate(all="ignore"):
            predicted = observation.predict(full, theta[None])[0]
        for k, seen in enumerate(experiment.seen.T):
            y = experiment.y[seen, k]
            if len(y) < 3 or y.std() <= MIN_MOTION_OVER_NOISE * np.diff(y).std() / np.sqrt(2.0):
                continue
            with np.errstate(all="ignore"):
                moves = np.ptp(predicted[seen, k]) > STILL * np.ptp(y)
            if not moves:
                yield labelled_name(experiment.names[k], observation.label)
