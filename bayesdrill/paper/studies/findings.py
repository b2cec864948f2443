"""All that the studies of the paper find, as one record; tables and figures are made of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.insight import Verdict
from bayesdrill.paper.studies.bounds import Implied, Length
from bayesdrill.paper.studies.causes import Cause
from bayesdrill.paper.studies.control import Control
from bayesdrill.paper.studies.forward import Error, Reading
from bayesdrill.paper.studies.heuristic import Heuristic
from bayesdrill.paper.studies.shaft import Tone
from bayesdrill.paper.studies.simultaneous import End
from bayesdrill.paper.studies.verification import Verification
from bayesdrill.record import Experiment

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Misfits:
    """The paper's misfit per measured number of one record, of which there are `numbers`.

    `others`: the largest of the heuristic's from other starts.  `stepped`: where it ends with the
    paper's integrator, computed with that; None with a measured input.
    `truth`: None where it is not known.  95 % of records have it between `low` and `high` there.
    """

    record: str
    numbers: int
    guess: float
    heuristic: float
    others: float
    stepped: float | None
    map: float
    truth: float | None
    low: float
    high: float

    @property
    def explained(self) -> bool:
        """Whether the best fit leaves no more than noise."""
        return self.map <= self.high


@dataclass(frozen=True, slots=True, kw_only=True)
class Nine:
    """The nine-parameter study of one record; vectors `(D,)` of `names`, physical, SI.

    `draws (N, D)`: of the posterior; `signals (T, K)`: of the heuristic's estimate; `given`: the
    parameters that were not searched, each with its value or formula.
    """

    name: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    given: tuple[str, ...]
    experiment: Experiment
    heuristic: Heuristic
    signals: Array
    truth: Array | None
    draws: Array
    verdict: Verdict
    misfits: Misfits
    causes: tuple[Cause, ...]
    converged: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """`ends`: of simultaneous searches, whose distances are from the truth of `searched`."""

    readings: tuple[Reading, ...]
    errors: tuple[Error, ...]
    verification: Verification
    lengths: tuple[Length, ...]
    implied: tuple[Implied, ...]
    searched: str
    symmetries: tuple[tuple[str, ...], ...]
    ends: tuple[End, ...]
    control: tuple[Control, ...]
    nines: tuple[Nine, ...]
    tones: tuple[Tone, ...]

    @property
    def converged(self) -> bool:
        return self.verification.converged and all(nine.converged for nine in self.nines)
