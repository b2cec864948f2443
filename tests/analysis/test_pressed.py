"""Draws that crowd at an end of their prior, against those that only may look so."""

from __future__ import annotations

import numpy as np
from together import for_each

from bayesdrill.inference.priors import (
    HalfNormal,
    LogNormal,
    LogUniform,
    Prior,
    TruncatedNormal,
    Uniform,
)
from bayesdrill.sampling.extended_priors import pressed_against

N = 4000
U = (np.arange(N) + 0.5) / N
EXPONENTIAL = -np.log(U)
BOX = Uniform(0.5, 1.5)


def test_draws_that_want_past_an_end_are_told() -> None:
    """Mutant killed: nothing is ever pressed."""
    cases = {
        "above": (BOX, 1.5 - 0.02 * EXPONENTIAL, 1.5),
        "below, closely": (BOX, 0.5 + 1e-8 * EXPONENTIAL, 0.5),
        "log-uniform": (LogUniform(1e-3, 1.0), 1e-3 * (1.0 + 0.05 * EXPONENTIAL), 1e-3),
        "truncated": (TruncatedNormal(1.0, 0.3, 0.2, 2.0), 0.2 + 1e-3 * EXPONENTIAL, 0.2),
        "zero": (HalfNormal(1.0), 1e-3 * EXPONENTIAL, 0.0),
    }

    def check(prior: Prior, draws: np.ndarray, end: float) -> None:
        assert pressed_against(draws, prior) == end

    for_each(cases, check)


def test_a_parameter_known_only_through_its_prior_is_not_reported() -> None:
    """Mutant killed: draws of the prior itself, dense at an end or not, are taken for a crowd."""
    cases = [
        BOX,
        LogUniform(1e-3, 1.0),
        TruncatedNormal(1.0, 0.3, 0.2, 1.05),
        HalfNormal(1.0),
        LogNormal(1.0, 2.0),
    ]

    def check(prior: Prior) -> None:
        assert pressed_against(prior.quantile(U), prior) is None

    for_each({str(prior): (prior,) for prior in cases}, check)


def test_the_corners_of_a_box_of_priors_are_no_pull() -> None:
    """Nine unknowns that share one scale: the marginal rises like its eighth power."""
    scale = U ** (1.0 / 9.0)
    assert pressed_against(scale, Uniform(0.0, 1.0)) is None


def test_a_peak_near_an_end_that_does_not_touch_it_is_not_reported() -> None:
    """Mutant killed: near is taken for pressed."""

    def check(sd: float) -> None:
        near = 1.5 - 3.0 * sd + sd * np.sqrt(2.0) * np.cos(np.pi * U)
        assert pressed_against(near, BOX) is None

    for_each({str(sd): (sd,) for sd in [1e-4, 5e-3]}, check)
