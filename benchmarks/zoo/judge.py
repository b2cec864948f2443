"""Whether a row did what it should: agreement of its means, and a list of complaints."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from scipy.special import ndtri

from benchmarks.zoo.row import Row
from benchmarks.zoo.runs import Run

LEVEL = 1e-3  # of rows without any error, so many disagree
SHARE = 0.03  # how far the share of a hump may be off, ...
WITHIN, LEAST = 0.2, 0.01  # ... or so much of itself, but for so much


@dataclass(frozen=True, slots=True)
class Agreement:
    """The largest distance of two means in standard errors, of which unknown, and what is allowed."""

    worst: float
    name: str
    limit: float

    @property
    def holds(self) -> bool:
        return self.worst <= self.limit  # so that NaN does not

    def __str__(self) -> str:
        return f"{self.name} by {self.worst:.1f} standard errors (at most {self.limit:.1f})"


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """A row, its two runs, and what is wrong with them; agreements are None where nothing is asked.

    `shares`: of the draws of each run in each hump.
    """

    row: Row
    runs: tuple[Run, ...]
    samples: int
    seeds: Agreement | None
    importance: Agreement | None
    shares: tuple[tuple[float, ...], ...]
    complaints: tuple[str, ...]

    @property
    def passed(self) -> bool:
        return not self.complaints

    @property
    def wall(self) -> float:
        return max(run.wall for run in self.runs)

    @property
    def rate(self) -> float:
        return min(run.rate for run in self.runs)

    @property
    def unknowns(self) -> int:
        return len(self.runs[0].mean)


def judged(
    row: Row,
    runs: tuple[Run, ...],
    samples: int,
    most: float,
    shares: tuple[tuple[float, ...], ...] = (),
) -> Outcome:
    """`most`: seconds that a run may take."""
    seeds = between(*runs) if row.sound else None
    importance = weighted(runs) if row.sound else None
    found = [text for run in runs for text in _of_run(row, run, most)]
    if row.sound and seeds is not None:
        found += [*_of_means(seeds, importance), *_of_humps(row, shares)]
    return Outcome(
        row=row,
        runs=runs,
        samples=samples,
        seeds=seeds,
        importance=importance,
        shares=shares,
        complaints=tuple(dict.fromkeys(found)),
    )


def between(first: Run, second: Run) -> Agreement | None:
    """Of two runs of one posterior; None where one of them has no means."""
    if not first.mean or not second.mean:
        return None
    return _worst(
        first.mean,
        lambda name: first.mean[name] - second.mean[name],
        lambda name: math.hypot(_error(first, name), _error(second, name)),
        len(first.mean),
    )


def weighted(runs: Sequence[Run]) -> Agreement | None:
    """Of each run with its own importance weights; None where one of them has none."""
    found = [_with_weights(run, len(runs)) for run in runs]
    kept = [one for one in found if one is not None]
    return max(kept, key=lambda one: _order(one.worst)) if len(kept) == len(found) else None


def _with_weights(run: Run, times: int) -> Agreement | None:
    own = run.importance
    if own is None or not run.mean:
        return None
    return _worst(
        run.mean,
        lambda name: run.mean[name] - own.mean.get(name, math.nan),
        lambda name: math.hypot(_error(run, name), own.error.get(name, math.nan)),
        times * len(run.mean),
    )


def _worst(
    names: Mapping[str, float],
    difference: Callable[[str], float],
    error: Callable[[str], float],
    comparisons: int,
) -> Agreement:
    distances = {name: _ratio(abs(difference(name)), error(name)) for name in names}
    worst = max(distances, key=lambda name: _order(distances[name]))
    return Agreement(distances[worst], worst, limit(comparisons))


def limit(comparisons: int) -> float:
    """Standard errors that the largest of so many normal deviations exceeds with chance LEVEL."""
    return -float(ndtri(0.5 * LEVEL / comparisons))


def _error(run: Run, name: str) -> float:
    draws = run.draws.get(name, 0.0)
    return run.sd[name] / math.sqrt(draws) if draws > 0 else math.nan


def _ratio(difference: float, error: float) -> float:
    return difference / error if error > 0 else math.nan


def _order(distance: float) -> float:
    """NaN is worse than any number."""
    return math.inf if math.isnan(distance) else distance


def _of_run(row: Row, run: Run, most: float) -> list[str]:
    if run.status is None:
        return [f"stopped after {run.wall:.0f} s"]
    found = [f"{run.wall:.0f} s"] if run.wall > most else []
    if run.status not in (0, 3):
        found.append(f"status {run.status}: {run.said.strip().rpartition(chr(10))[2]}")
    elif row.sound and run.status == 3:
        found.append(f"status 3: {'; '.join(run.reasons)}")
    elif not row.sound and run.status == 0:
        found.append("status 0, as if all were well")
    elif row.sound and not run.converged:
        found.append("not converged")
    elif row.reason is not None and not any(row.reason in reason for reason in run.reasons):
        found.append(f"no reason says '{row.reason}'")
    return found


def _of_means(seeds: Agreement, importance: Agreement | None) -> list[str]:
    found = [] if seeds.holds else [f"seeds disagree on {seeds}"]
    if importance is None:
        found.append("no importance weights")
    elif not importance.holds:
        found.append(f"importance weights disagree on {importance}")
    return found


def _of_humps(row: Row, shares: Sequence[tuple[float, ...]]) -> list[str]:
    if row.humps is None:
        return []
    exact = row.humps.exact
    if shares and all(len(of) == len(exact) and all(map(_near, of, exact)) for of in shares):
        return []
    said = ", ".join(_written(of) for of in shares)
    return [f"shares of the humps {said}, exactly {_written(exact)}"]


def _near(share: float, exact: float) -> bool:
    return abs(share - exact) <= min(SHARE, max(WITHIN * exact, LEAST))


def _written(shares: Sequence[float]) -> str:
    return " ".join(f"{share:.3f}" for share in shares)
