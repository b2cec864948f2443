"""Draws that crowd at an end of their prior, against those that only may look so."""

from __future__ import annotations

import numpy as np
import pytest

from bayesdrill.inference.priors import (
    HalfNormal,
    LogNormal,
    LogUniform,
    Prior,
    TruncatedNormal,
    Uniform,
)
from bayesdrill.insight.diagnostics import pressed_against

N = 4000
U = (np.arange(N) + 0.5) / N
EXPONENTIAL = -np.log(U)
BOX = Uniform(0.5, 1.5)


@pytest.mark.parametrize(
    ("prior", "draws", "end"),
    [
        (BOX, 1.5 - 0.02 * EXPONENTIAL, 1.5),
        (BOX, 0.5 + 1e-8 * EXPONENTIAL, 0.5),
        (LogUniform(1e-3, 1.0), 1e-3 * (1.0 + 0.05 * EXPONENTIAL), 1e-3),
        (TruncatedNormal(1.0, 0.3, 0.2, 2.0), 0.2 + 1e-3 * EXPONENTIAL, 0.2),
        (HalfNormal(1.0), 1e-3 * EXPONENTIAL, 0.0),
    ],
    ids=["above", "below, closely", "log-uniform", "truncated", "zero"],
)
def test_draws_that_want_past_an_end_are_told(prior: Prior, draws: np.ndarray, end: float) -> None:
    """Mutant killed: nothing is ever pressed."""
    assert pressed_against(draws, prior) == end


@pytest.mark.parametrize(
    "prior",
    [
        BOX,
        LogUniform(1e-3, 1.0),
        TruncatedNormal(1.0, 0.3, 0.2, 1.05),
        HalfNormal(1.0),
        LogNormal(1.0, 2.0),
    ],
    ids=str,
)
def test_a_parameter_known_only_through_its_prior_is_not_reported(prior: Prior) -> None:
    """Mutant killed: draws of the prior itself, dense at an end or not, are taken for a crowd."""
    assert pressed_against(prior.quantile(U), prior) is None


def test_the_corners_of_a_box_of_priors_are_no_pull() -> None:
    """Nine unknowns that share one scale: the marginal rises like its eighth power."""
    scale = U ** (1.0 / 9.0)
    assert pressed_against(scale, Uniform(0.0, 1.0)) is None


@pytest.mark.parametrize("sd", [1e-4, 5e-3])
def test_a_peak_near_an_end_that_does_not_touch_it_is_not_reported(sd: float) -> None:
    """Mutant killed: near is taken for pressed."""
    near = 1.5 - 3.0 * sd + sd * np.sqrt(2.0) * np.cos(np.pi * U)
    assert pressed_against(near, BOX) is None
