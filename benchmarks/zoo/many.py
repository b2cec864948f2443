"""Rows of many modes: puzzles whose masses a grid knows."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from bayesdrill.config.building.case import ResolvedCase
from bayesdrill.inference.posterior import Posterior
from benchmarks.modes import collection
from benchmarks.modes.grid import Modes
from benchmarks.modes.judge import SHOWN
from benchmarks.modes.puzzle import Puzzle
from benchmarks.zoo.row import Array, Row

NAMES = (
    "far_apart", "blank", "long_bits", "two_lags", "sixteen", "ridges", "held_rotor",
    "switched_on", "two_lags_of_a_motor", "aliases_that_remember",
)  # fmt: skip


def rows() -> tuple[Row, ...]:
    return tuple(_posed(one) for one in collection.chosen(NAMES))


def _posed(puzzle: Puzzle) -> Row:
    made = Posed(puzzle)
    return Row(name=puzzle.name, shows=puzzle.shows, config=puzzle.entries, made=made, humps=made)


@dataclass(frozen=True)
class Posed:
    """The record of a puzzle, whatever the seed of the run, and its modes."""

    puzzle: Puzzle
    available = True

    def record(self, case: ResolvedCase, path: Path) -> str:
        return self.puzzle.record(path)

    @property
    def exact(self) -> tuple[float, ...]:
        modes = self._known[1]
        return tuple(modes.masses[modes.above(SHOWN)].tolist())

    def shares(self, draws: Mapping[str, Array]) -> tuple[float, ...]:
        posterior, modes = self._known
        theta = np.stack([draws[name] for name in posterior.space.free], axis=-1)
        found = modes.shares(posterior.coordinates.from_physical(theta))
        return tuple(found[modes.above(SHOWN)].tolist())

    @cached_property
    def _known(self) -> tuple[Posterior, Modes]:
        with tempfile.TemporaryDirectory() as folder:
            posterior = self.puzzle.load(Path(folder)).job.problem.posterior
        return posterior, self.puzzle.modes(posterior)
