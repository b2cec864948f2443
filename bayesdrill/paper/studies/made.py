"""Records made for the studies: of rigs with known parameters, by the model that then finds them."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import seeds
from bayesdrill.inference import Posterior

Array = NDArray[np.float64]


def record(posterior: Posterior, truth: Array, seed: int, index: int) -> Posterior:
    """With record `index` of the rig `truth (D,)`: its noise is the same for every sigma but in size."""
    rng = seeds.stream(seed, "study", index)
    y = posterior.likelihood.signals(truth[None])
    return of(posterior, posterior.likelihood.noise.draw(y, np.empty((1, 0)), rng)[0])


def clean(posterior: Posterior, truth: Array) -> Posterior:
    """With a record without noise."""
    return of(posterior, posterior.likelihood.signals(truth[None])[0])


def with_sigma(posterior: Posterior, sigma: float) -> Posterior:
    """With this noise in every channel."""
    likelihood = posterior.likelihood
    known = dict.fromkeys(range(likelihood.noise.n_channels), sigma)
    noise = dataclasses.replace(likelihood.noise, known=known)
    return dataclasses.replace(posterior, likelihood=likelihood.with_alone(noise=noise))


def of(posterior: Posterior, y: Array) -> Posterior:
    """With the record `y (T, K)`."""
    likelihood = posterior.likelihood
    own = likelihood.with_alone(response=likelihood.response.with_record(y))
    return dataclasses.replace(posterior, likelihood=own)
