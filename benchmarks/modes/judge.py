"""A run of a puzzle as `bayesdrill posterior` does it, beside the masses that a grid knows."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesdrill.sampling.evidence import Evidence
from benchmarks.modes.grid import Modes
from benchmarks.modes.puzzle import Puzzle

Array = NDArray[np.float64]

SHOWN = 0.02  # of the posterior: what holds more has to be found ...
WITHIN = 0.2  # ... with its mass, so much of itself off, and ...
ERRORS = 3.0  # ... so many standard errors of independent draws
GRID, FAR = 5e-3, 4.0  # of the log evidence: what the grid may be off, and standard errors
REASON = re.compile(r"\b(maxim\w+|modes?|alias\w*|elsewhere|two places|places that)\b")


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """`found (M,)`: shares of the draws in the modes of the grid; `draws`: nearly independent ones.

    `reasons`: why the run says that it must not be believed; `seconds`: of the processor, of the run.
    """

    puzzle: Puzzle
    unknowns: tuple[str, ...]
    modes: Modes
    found: Array
    draws: int
    reasons: tuple[str, ...]
    seconds: float
    evidence: Evidence | None = None

    @property
    def weighed(self) -> bool:
        """Whether the evidence, if it is told, is that of the grid."""
        if self.evidence is None:
            return True
        off = self.evidence.log_z - self.evidence.steps - self.modes.log_z
        return abs(off) < GRID + FAR * self.evidence.error

    @property
    def status(self) -> int:
        return 3 if self.reasons else 0

    @property
    def missed(self) -> tuple[int, ...]:
        """Modes above `SHOWN` whose share is wrong."""
        true = self.modes.masses
        allowed = WITHIN * true + ERRORS * np.sqrt(true * (1.0 - true) / self.draws)
        wrong = (np.abs(self.found - true) > allowed) & (true > SHOWN)
        return tuple(int(m) for m in np.flatnonzero(wrong))

    @property
    def warned(self) -> bool:
        """Whether one of the reasons says that there may be other maxima."""
        return any(REASON.search(reason) for reason in self.reasons)

    @property
    def passed(self) -> bool:
        """Every mode and their evidence, or the reason for what is missing."""
        return self.warned or (not self.missed and self.weighed)


def run(puzzle: Puzzle, folder: Path, finer: int = 1) -> Outcome:
    """`finer`: see `Puzzle.modes`."""
    case = puzzle.load(folder)
    posterior = case.job.problem.posterior
    known = puzzle.modes(posterior, finer)
    begun = time.process_time()
    ran = case.sample()
    reasons = ran.judge().view.reasons
    seconds = time.process_time() - begun
    kept = ran.sampled.theta[:, ran.sampled.convergence.burn_in :]
    z = posterior.coordinates.from_physical(kept.reshape(-1, kept.shape[-1]))
    return Outcome(
        puzzle=puzzle,
        unknowns=case.unknowns,
        modes=known,
        found=known.shares(z),
        draws=ran.sampled.draws.shape[0] * ran.sampled.draws.shape[1],
        reasons=reasons,
        seconds=seconds,
        evidence=ran.evidence,
    )
