"""Compass search: the best of a step either way along each unknown, and half the step where none is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesdrill.inference import laplace
from bayesdrill.sampling import Optimum, Task

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Compass:
    shortest: Annotated[float, Field(gt=0, lt=1, description="Step at which it ends")] = 1e-4

    def check(self, unknown: Sequence[str]) -> None:
        if len(unknown) > 20:
            raise ValueError(f"{len(unknown)} unknowns are too many for this search; hold some")

    def __call__(self, task: Task, starts: Array, evaluations: int) -> list[Optimum]:
        return [self._search(task, start, evaluations) for start in starts]

    def _search(self, task: Task, start: Array, evaluations: int) -> Optimum:
        physical = task.coordinates.to_physical
        best, spent, step = start.copy(), 1, 1.0
        value = task.at(start)
        while step > self.shortest and spent < evaluations:
            z = task.coordinates.from_physical(best[None])[0]
            ways = laplace.matrix_root(task.covariance(best)).T * step
            before = value
            for way in np.concatenate([ways, -ways]):
                if spent == evaluations:
                    break
                there = physical((z + way)[None])[0]
                spent, found = spent + 1, task.at(there)
                if found > value:
                    best, value = there, found
            step *= 1.0 if value > before else 0.5
        settled = step <= self.shortest
        return Optimum(theta=best, value=value, evaluations=spent, settled=settled)
