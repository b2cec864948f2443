"""Likelihoods that are wrong on purpose, and studies with them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from bayesdrill.inference.noise.gaussian import Gaussian
from bayesdrill.insight.calibration.refit import Study


@dataclass(frozen=True)
class Misfit:
    """Gaussian noise whose misfit counts `factor` times: 2 where the 1/2 before it is forgotten."""

    right: Gaussian
    factor: float

    def __getattr__(self, name: str) -> object:
        if name == "right":  # while it is unpickled
            raise AttributeError(name)
        return getattr(self.right, name)

    def log_likelihood(self, misfit: np.ndarray, unknown: np.ndarray) -> np.ndarray:
        return self.right.log_likelihood(self.factor * misfit, unknown)


def with_misfit(study: Study, factor: float) -> Study:
    """The same study, its records made as before and its posteriors wrong."""
    likelihood = study.posterior.likelihood
    noise = Misfit(likelihood.noise, factor)
    posterior = dataclasses.replace(
        study.posterior, likelihood=dataclasses.replace(likelihood, noise=noise)
    )
    return dataclasses.replace(study, posterior=posterior)
