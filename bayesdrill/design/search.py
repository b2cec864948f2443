"""Search for the levels that minimise the criterion within all limits.

For a linear rig, a bounded quasi-Newton method (L-BFGS-B; Byrd, Lu, Nocedal and Zhu 1995) uses the
exact gradient.  Penalties replace the limits of the rig and of the slew rate.  Penalties permit a
small excess, so the result is moved towards a waveform that keeps all limits, until enough draws
keep them.  For a rig with friction, levels are exchanged one by one (Meyer and Nachtsheim 1995).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError
from bayesdrill.design.limited_motion import KEPT_SHARE, LimitCheck, LimitPenalty
from bayesdrill.design.responses import (
    Evaluation,
    SimulatedSlopes,
    SuperposedPulses,
)
from bayesdrill.design.waveforms import FAMILIES

PENALTIES = (1e1, 1e3, 1e5)  # increasing weights of squared excesses of the limits
MAX_ITERATIONS = 120  # upper limit of iterations of a search with one weight
COARSE_DRAWS = 2  # number of draws in the first, fast searches from all starts
POLISHED = 2  # number of the best coarse results, from each of which a search with all draws starts
RANDOM_STARTS = 6  # number of random starts, in addition to the best two usual waveforms
SWEEPS = 2  # upper limit of passes of the exchange through all levels
EXCHANGED = 5  # number of levels that are tried in each hold interval
CONSTANTS = 13  # number of constant levels in a grid, each tried as an allowed waveform
REFINEMENTS = 4  # number of grids of constant levels, each six times as fine as the grid before


def safe_waveform(check: LimitCheck, repair: Callable[[Array], Array]) -> Array:
    """Return a waveform that keeps all limits; raises `InputError` if none is found.

    A grid of constant levels is tried first, and the middle allowed level is returned.  If no level
    is allowed, finer grids around the level with the least excess follow, as the allowed interval
    may be narrow.  If these grids fail, too, `repair` reduces the excess of the best level.
    """
    source = check.coming.source
    ends = source.low, source.high
    for _ in range(REFINEMENTS):
        levels = np.linspace(*ends, CONSTANTS)
        constants = [source.nearest_levels(np.full(source.count, level)) for level in levels]
        kept = np.array([check.kept_share(each) for each in constants])
        good = np.flatnonzero(kept >= KEPT_SHARE)
        if len(good):
            return constants[int(good[len(good) // 2])]
        nearest = int(np.argmin([check.excess(each) for each in constants]))
        ends = levels[max(nearest - 1, 0)], levels[min(nearest + 1, CONSTANTS - 1)]
    best = repair(constants[nearest])
    if check.kept_share(best) >= KEPT_SHARE:
        return best
    pairs = zip(check.limits, check.broken(best).mean(axis=0), strict=True)
    failed = "; ".join(f"{x.describe()} fails in {100 * s:.3g} %" for x, s in pairs if s > 0)
    message = (
        f"no waveform from {source.low:g} to {source.high:g} keeps all limits in 99 % of draws"
    )
    raise InputError.at("--limit", f"{message} ({failed}); widen a limit or the range")


def usual_waveforms(
    evaluation: Evaluation,
    check: LimitCheck,
    safe: Array,
    rng: np.random.Generator,
) -> dict[str, Array]:
    """Return the best waveform of each family, after a move towards `safe` to keep the limits."""
    source, best = evaluation.coming.source, {}
    for name, family in FAMILIES.items():
        allowed = [
            check.shorten(safe, source.nearest_levels(levels)) for levels in family(source, rng)
        ]
        best[name] = min(allowed, key=lambda levels: value(evaluation, levels))
    return best


def value(evaluation: Evaluation, levels: Array) -> float:
    """Return the criterion of a waveform; inf if it cannot be computed."""
    with np.errstate(all="ignore"):
        information = evaluation.information(levels)
        if not np.isfinite(information).all():
            return np.inf
        return evaluation.targets.criterion(information)[0]


def least_excess(penalty: LimitPenalty, levels: Array) -> Array:
    """Return levels, near the given ones, with the least excess over the limits."""
    return _minimise(None, penalty, levels, PENALTIES[-1])


def descend(
    evaluation: SuperposedPulses,
    penalty: LimitPenalty,
    check: LimitCheck,
    safe: Array,
    waveforms: Sequence[Array],
    rng: np.random.Generator,
    progress: Callable[[float], None],
) -> Array:
    """Return the best result of descents from the two best `waveforms` and from random levels."""
    source = evaluation.coming.source
    ranked = sorted(waveforms, key=lambda levels: value(evaluation, levels))
    starts = [*ranked[:2], *_random(evaluation, rng)]
    coarse = evaluation.with_first(COARSE_DRAWS), penalty.with_first(COARSE_DRAWS)
    ends = [ranked[0]]
    for number, start in enumerate(starts):
        progress(number / (len(starts) + POLISHED))
        ends.append(check.shorten(safe, source.nearest_levels(_descend(*coarse, start))))
    ends.sort(key=lambda levels: value(evaluation, levels))
    for number, end in enumerate(ends[:POLISHED]):
        progress((len(starts) + number) / (len(starts) + POLISHED))
        ends.append(check.shorten(safe, source.nearest_levels(_descend(evaluation, penalty, end))))
    return min(ends, key=lambda levels: value(evaluation, levels))


def _descend(evaluation: SuperposedPulses, penalty: LimitPenalty, levels: Array) -> Array:
    """Minimise the criterion, with penalties of increasing weight if there are limits."""
    constrained = penalty.limits or evaluation.coming.source.slew < np.inf
    for weight in PENALTIES if constrained else PENALTIES[:1]:
        levels = _minimise(evaluation, penalty, levels, weight)
    return levels


def _random(evaluation: Evaluation, rng: np.random.Generator) -> Iterator[Array]:
    source = evaluation.coming.source
    for number in range(RANDOM_STARTS):
        x = rng.random(source.count)
        yield source.low + (source.high - source.low) * (np.round(x) if number % 2 else x)


def _minimise(
    evaluation: SuperposedPulses | None, penalty: LimitPenalty, start: Array, weight: float
) -> Array:
    """Minimise the criterion, if `evaluation` is given, plus `weight` times the penalties."""
    from scipy.optimize import minimize  # late: few commands need this

    source = penalty.source
    size, max_step = max(abs(source.low), abs(source.high)), source.slew * source.interval

    def objective(scaled: Array) -> tuple[float, Array]:
        levels = scaled * size
        total, slope = penalty(levels)
        if max_step < np.inf:
            steps = np.diff(levels, prepend=0.0) / size
            over = np.sign(steps) * np.maximum(np.abs(steps) - max_step / size, 0.0)
            total += float(over @ over)
            slope = slope + 2.0 * (over - np.append(over[1:], 0.0)) / size
        total, slope = weight * total, weight * slope
        if evaluation is not None:
            gain, along = evaluation.value_and_slope(levels)
            total, slope = total + gain, slope + along
        return total, slope * size

    result = minimize(
        objective,
        start / size,
        jac=True,
        method="L-BFGS-B",
        bounds=[(source.low / size, source.high / size)] * source.count,
        options={"maxiter": MAX_ITERATIONS, "maxcor": 20, "ftol": 1e-10, "gtol": 1e-6},
    )
    return np.asarray(result.x * size)


def exchange(
    evaluation: SimulatedSlopes,
    check: LimitCheck,
    safe: Array,
    waveforms: Sequence[Array],
    rng: np.random.Generator,
    progress: Callable[[float], None],
) -> Array:
    """Improve the best of `waveforms` by exchanging single levels; `safe` is unused.

    In random order, each hold interval gets the best of a few levels that keep the limits.
    """
    source = evaluation.coming.source
    best = min(waveforms, key=lambda levels: value(evaluation, levels))
    height, tried = value(evaluation, best), np.linspace(source.low, source.high, EXCHANGED)
    for sweep in range(SWEEPS):
        before = height
        for number, k in enumerate(rng.permutation(source.count)):
            progress((sweep + number / source.count) / SWEEPS)
            for level in tried[tried != best[k]]:
                levels = best.copy()
                levels[k] = level
                if not np.array_equal(source.nearest_levels(levels), levels):
                    continue
                new = value(evaluation, levels)
                if new < height and check.kept_share(levels) >= KEPT_SHARE:
                    best, height = levels, new
        if height > before - 1e-3:
            break
    return best
