"""Draws at an end of their prior: those that crowd there, and those that no draw beyond follows."""

from __future__ import annotations

import numpy as np
from support.case_tables import run_cases

from bayesdrill.analysis.diagnostics import end_at_nominal, pressed_against
from bayesdrill.inference.priors import (
    HalfNormal,
    LogNormal,
    LogUniform,
    Prior,
    TruncatedNormal,
    Uniform,
)

N = 4000
U = (np.arange(N) + 0.5) / N
EXPONENTIAL = -np.log(U)
BOX = Uniform(0.5, 1.5)


@run_cases(
    "prior, draws, end",
    [
        (BOX, 1.5 - 0.02 * EXPONENTIAL, 1.5),
        (BOX, 0.5 + 1e-8 * EXPONENTIAL, 0.5),
        (LogUniform(1e-3, 1.0), 1e-3 * (1.0 + 0.05 * EXPONENTIAL), 1e-3),
        (TruncatedNormal(1.0, 0.3, 0.2, 2.0), 0.2 + 1e-3 * EXPONENTIAL, 0.2),
        (HalfNormal(1.0), 1e-3 * EXPONENTIAL, 0.0),
    ],
    ["above", "below, closely", "log-uniform", "truncated", "zero"],
)
def test_draws_that_want_past_an_end_are_told(prior: Prior, draws: np.ndarray, end: float) -> None:
    """Mutant killed: nothing is ever pressed."""
    assert pressed_against(draws, prior) == end


@run_cases(
    "prior",
    [
        BOX,
        LogUniform(1e-3, 1.0),
        TruncatedNormal(1.0, 0.3, 0.2, 1.05),
        HalfNormal(1.0),
        LogNormal(1.0, 2.0),
    ],
)
def test_a_parameter_known_only_through_its_prior_is_not_reported(prior: Prior) -> None:
    """Mutant killed: draws of the prior itself, dense at an end or not, are taken for a crowd."""
    assert pressed_against(prior.quantile(U), prior) is None


def test_the_corners_of_a_box_of_priors_are_no_pull() -> None:
    """Nine unknowns that share one scale: the marginal rises like its eighth power."""
    scale = U ** (1.0 / 9.0)
    assert pressed_against(scale, Uniform(0.0, 1.0)) is None


@run_cases("sd", [1e-4, 5e-3])
def test_a_peak_near_an_end_that_does_not_touch_it_is_not_reported(sd: float) -> None:
    """Mutant killed: near is taken for pressed."""
    near = 1.5 - 3.0 * sd + sd * np.sqrt(2.0) * np.cos(np.pi * U)
    assert pressed_against(near, BOX) is None


def bell(middle: float, sd: float, low: float = -np.inf, high: float = np.inf) -> np.ndarray:
    """Draws of a normal that is cut at its ends."""
    return TruncatedNormal(middle, sd, low, high).quantile(U)


@run_cases(
    "prior, draws, end",
    [
        (Uniform(1.0, 1.5), bell(1.0, 0.01, 1.0, 1.5), 1.0),
        (LogUniform(0.5, 1.0), bell(1.0, 0.01, 0.5, 1.0), 1.0),
        (TruncatedNormal(1.0, 0.3, 1.1, 3.0), bell(1.4, 0.01), 1.1),
        (Uniform(0.2, 0.9), bell(0.5, 0.01), 0.9),
        (Uniform(0.99, 1.5), bell(1.0, 0.01, 0.99), 0.99),
        (
            Uniform(0.99, 1.5),
            bell(1.2, 0.01),
            None,
        ),
        (Uniform(0.5, 1.5), bell(1.0, 0.3, 0.5, 1.5), None),
        (Uniform(0.0, 40.0), bell(0.0, 1.0, 1e-9), None),
        (LogNormal(1.0, 0.5), bell(1.0, 0.01), None),
    ],
    [
        "begins at nominal",
        "ends at nominal",
        "begins beyond it",
        "ends beyond it, far from the draws",
        "begins a little before it",
        "begins a little before it, far from the draws",
        "nominal in the middle",
        "an end at zero",
        "no end at all",
    ],
)
def test_an_end_at_the_nominal_value_is_found_where_it_cuts_draws_off(
    prior: Prior, draws: np.ndarray, end: float | None
) -> None:
    """Mutants killed: one end alone is looked at; an end is found wherever the nominal value is near."""
    assert end_at_nominal(draws, prior, 1.0) == end
