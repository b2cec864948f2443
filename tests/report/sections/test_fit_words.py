"""What a figure of the fit shows of long records, and the unit of its times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import bayesdrill as bd
from bayesdrill.inference import residual_checks
from bayesdrill.report.sections.fit_words import corners, every_fit, extremes

ROOT = Path(__file__).parents[3]


@given(st.integers(3, 5000), st.integers(10, 300))
def test_extremes_keep_ends_and_peaks(n: int, most: int) -> None:
    y = np.random.default_rng(n).standard_normal(n)
    kept = extremes(y, most)
    assert len(kept) <= most
    assert len(np.unique(kept)) == len(kept)
    assert {0, n - 1, int(y.argmin()), int(y.argmax())} <= set(kept.tolist())


@given(st.integers(2, 3000), st.integers(1, 40))
def test_corners_of_stairs_are_where_they_rise(n: int, length: int) -> None:
    u = (np.arange(n) // length % 3).astype(float)
    kept = corners(u, 500)
    assert len(kept) <= 500
    if len(kept) < 500 and n // length < 400:
        at = np.searchsorted(kept, np.arange(n), side="right") - 1
        np.testing.assert_array_equal(u[kept[at]], u)


@pytest.mark.parametrize(("many", "unit", "end"), [(1e4, "ms", 8000.0), (5e3, "s", 8.0)])
def test_times_of_very_many_units_are_in_seconds(
    many: float, unit: str, end: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bayesdrill.config.resolve.assembly.MAX_SHOWN_TIME", many)
    problem = bd.load(ROOT / "configs" / "example_rig.yaml").job.problem
    space, likelihood = problem.posterior.space, problem.posterior.likelihood
    at = space.vector(space.start)
    (fit,) = every_fit(problem, at, residual_checks.residual_summaries(likelihood, at))
    assert fit.time.latex_unit == unit
    assert fit.t[-1] == pytest.approx(end)
