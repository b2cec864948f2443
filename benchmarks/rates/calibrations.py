"""Likelihoods that are wrong on purpose, and studies with them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from support.small_problems import replace_only

from bayesdrill.analysis.calibration import CalibrationStudy
from bayesdrill.inference.noise.contract import Residuals
from bayesdrill.inference.noise.white import White


@dataclass(frozen=True)
class Misfit:
    """Gaussian noise whose misfit counts `factor` times: 2 where the 1/2 before it is forgotten."""

    right: White
    factor: float

    def __getattr__(self, name: str) -> object:
        if name == "right":  # while it is unpickled
            raise AttributeError(name)
        return getattr(self.right, name)

    def log_likelihood(self, residuals: Residuals, own: np.ndarray) -> np.ndarray:
        wrong = SimpleNamespace(squares=self.factor * residuals.squares)
        return self.right.log_likelihood(wrong, own)


def with_misfit(study: CalibrationStudy, factor: float) -> CalibrationStudy:
    """The same study, its records made as before and its posteriors wrong."""
    likelihood = study.posterior.likelihood
    noise = Misfit(likelihood.only_observation.noise, factor)
    posterior = dataclasses.replace(
        study.posterior, likelihood=replace_only(likelihood, noise=noise)
    )
    return dataclasses.replace(study, posterior=posterior)
