"""Predict sds after the designed waveform with other channels, rates, durations or repeats."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.design.knowledge import PresentKnowledge
from bayesdrill.design.promise import geometric_mean, information
from bayesdrill.design.responses import ComingExperiment, TargetCovariance
from bayesdrill.design.source import SourceLimits
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior

REPEATS = (2, 4)  # numbers of repetitions of the experiment


def variant_sds(
    recorded: Observation,
    coming: ComingExperiment,
    batch: list[Array],
    knowledge: PresentKnowledge,
    slopes: Array,
    sds: Array,
    now: Array,
) -> dict[str, tuple[float, ...]]:
    """Return relative sds of targets with `slopes (W, k, m)` by the name of a variant.

    The predicted `sds (k,)` of the `coming` experiment with levels `batch` are multiplied by ratios
    of Gaussian sds: variant / coming experiment.  They are at most the present sds `now (k,)`.
    `recorded` has the channels and the noise.
    """
    covariance = TargetCovariance(slopes=slopes, precision=knowledge.precision)

    def gaussian(posterior: Posterior) -> Array:
        spread = covariance.covariances(information(posterior, knowledge.draws))
        return geometric_mean(np.sqrt(spread.diagonal(axis1=1, axis2=2)))

    usual_sds, out = gaussian(coming.posterior(*batch)), {}
    for name, make in _variants(recorded, coming, batch):
        with suppress(ValueError):  # raised if the noise model needs every sample
            out[name] = tuple(np.minimum(sds * gaussian(make()) / usual_sds, now).tolist())
    return out


def _variants(
    recorded: Observation, coming: ComingExperiment, batch: list[Array]
) -> Iterator[tuple[str, Callable[[], Posterior]]]:
    """Yield the name of each variant, and a function that returns its posterior."""
    shape, names = coming.observation.experiment.y.shape, coming.observation.experiment.names
    source = coming.source

    def missing(samples: slice, channels: list[int]) -> Posterior:
        seen = np.zeros(shape, dtype=bool)
        seen[samples, channels] = True
        return coming.with_samples(seen).posterior(*batch)

    def driven(other: SourceLimits, repeats: int) -> Posterior:
        again = ComingExperiment.from_observation(recorded, other)
        return again.posterior(*(np.tile(levels, repeats) for levels in batch))

    every = list(range(len(names)))
    if len(names) > 1:
        for k, name in enumerate(names):
            yield f"only {name}", partial(missing, slice(None), [k])
    if len(names) > 2:
        for k, name in enumerate(names):
            yield f"without {name}", partial(missing, slice(None), every[:k] + every[k + 1 :])
    yield "half the rate", partial(missing, slice(None, None, 2), every)
    faster = dataclasses.replace(source, hold=source.interval, rate=2.0 * source.rate)
    yield "twice the rate", partial(driven, faster, 1)
    longer = dataclasses.replace(source, duration=2.0 * source.count * source.interval)
    yield "twice the time", partial(driven, longer, 2)
    for count in REPEATS:
        yield f"{count} repeats", partial(coming.posterior, *batch * count)
