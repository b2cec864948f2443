"""How exact a compressed likelihood is, against numbers of 80 bits, on the zoo's linear rows.

`python -m benchmarks.precision [ROW ...]` runs each row, compresses its records however short they are,
and prints a table: the largest error of log L at draws of the chain, compressed and by the exact
simulator; how much the last place of one parameter changes log L, which no program that takes numbers
of 53 bits is exact to; and how many draws are within the stated bound.  Records of more than `MOST`
samples, and rigs that rub, are left out.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bayesdrill as bd
from bayesdrill.inference import compression
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.compression.simulator import even_record
from bayesdrill.rig.kernels.sums import SQUARES
from benchmarks.zoo import folder, rows

MOST, DRAWS = 200_000, 20
ROUNDING = 1e-13  # of a record, which numbers of 53 bits leave and no bound has

Array = NDArray[np.float64]


def true_squares(observation: Observation, full: Array) -> Array:
    """Sums of squares `(K,)` of a rig `(P,)` whose channels are not late, by steps of 80 bits."""
    record = even_record(observation.response.by_samples)
    assert record is not None
    total = np.zeros(len(observation.experiment.channels), dtype=np.longdouble)
    for _, left in record.residuals(full):
        total += np.nansum(left.astype(np.longdouble) ** 2, axis=0)
    return total


def next_numbers(full: Array) -> Array:
    """A rig `(P,)` with the next larger number of one parameter, for each of them."""
    return np.where(np.eye(len(full), dtype=bool), np.nextafter(full, np.inf), full)


def errors(posterior: Posterior, draws: Array) -> Iterator[Array]:
    """Yield for each draw what log L is wrong by, compressed and exact, the stated bound, and by how
    much the last place of the parameter that does most changes it.
    """
    maximum = draws[np.argmax(posterior.likelihood(draws))]
    points = np.concatenate([maximum[None], draws[:: max(1, len(draws) // 256)]])
    made = compression.compressions(posterior, points, max_exact=0)
    short = compression.compressed(posterior, made).likelihood.observations
    for theta in draws[:: max(1, len(draws) // DRAWS)]:
        total = np.zeros(4)
        for observation in short:
            if not observation.response.functions:
                continue
            full = observation.simulator_parameters(posterior.space.full(theta[None]))
            simulator: Any = observation.response
            weights = observation.square_weights(theta[None])
            squares, bounds = (numbers[0, :, 0] for numbers in simulator.expanded(full))
            if simulator.exceeds_bound(full)[0]:
                continue
            exact = simulator.by_samples.sums(full, SQUARES)[0, :, 0]
            assert weights is not None
            truth, weight = true_squares(observation, full[0]), weights[0, :, 0] / 2
            size = np.sqrt(truth.astype(float) * np.nansum(observation.experiment.y**2, axis=0))
            wrong = [np.abs(sums - truth).astype(float) for sums in (squares, exact)]
            allowed = bounds + 2.0 * ROUNDING * size
            moved = [true_squares(observation, point) for point in next_numbers(full[0])]
            last = np.abs(np.subtract(moved, truth) @ weight).max()
            total += [
                float(number) for number in (*(weight @ each for each in (*wrong, allowed)), last)
            ]
        if total.any():
            yield total


def main(names: list[str]) -> None:
    print("| row | samples | compressed | exact | last place | within its bound |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    with TemporaryDirectory() as place:
        for row in rows.chosen(names or None):
            if row.seconds or not (row.sound and row.made.available):
                continue
            case = bd.load(folder.write(row, Path(place))[0])
            observations = case.job.problem.posterior.likelihood.observations
            samples = max(len(each.experiment.t) for each in observations)
            if samples > MOST or all(each.exact_reason for each in observations):
                continue
            run = case.sample()
            posterior = compression.uncompressed(case.job.problem.posterior)
            draws = run.sampled.draws.reshape(-1, run.sampled.draws.shape[-1])
            each = np.array(list(errors(posterior, draws)))
            if len(each):
                worst, count = each.max(axis=0), int((each[:, 0] <= each[:, 2]).sum())
                print(
                    f"| {row.name} | {samples} | {worst[0]:.0e} | {worst[1]:.0e} "
                    f"| {worst[3]:.0e} | {count} of {len(each)} |", flush=True,
                )  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1:])
