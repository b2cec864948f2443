"""How far runs are apart: laws of the numbers, whatever the runs."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases
from support.figure_checks import posterior

import bayesdrill as bd
from bayesdrill.analysis.comparison import PosteriorSummary, differing, overlay_rows
from bayesdrill.inference.posterior import Problem

CONFIG = Path(__file__).parents[2] / "configs" / "nominal_step.yaml"


@cache
def problem() -> Problem:
    return bd.load(CONFIG).job.problem


def layer(name: str, shift: float = 0.0, stretch: float = 1.0, **settings: str) -> PosteriorSummary:
    """Of the bundled problem; draws moved by `shift` sds and stretched about their means."""
    x = posterior(3000)[:, :9]
    mean, sd = x.mean(axis=0), x.std(axis=0, ddof=1)
    moved = mean + stretch * (x - mean) + shift * sd
    return PosteriorSummary(name=name, mark=name, problem=problem(), draws=moved, settings=settings)


def test_a_run_is_not_apart_from_itself() -> None:
    found = overlay_rows([layer("a"), layer("a")])
    assert [row.symbol.name for row in found] == list(problem().names)
    assert all(row.distance == 0.0 and row.pair == (0, 1) for row in found)
    assert all(row.agreed == problem().nominal[row.symbol.name] for row in found)
    assert differing([layer("a", seed="1"), layer("b", seed="1")]) == {}


@run_cases("shift, stretch", [(2.0, 1.0), (-0.7, 1.0), (3.0, 4.0)])
def test_a_shift_of_the_draws_is_how_far_they_are_apart(shift: float, stretch: float) -> None:
    """In sds of both: their root mean square."""
    for row in overlay_rows([layer("a"), layer("b", shift, stretch)]):
        assert row.distance == pytest.approx(abs(shift) / np.sqrt((1 + stretch**2) / 2))
        one, other = row.places
        assert one is not None
        assert other is not None
        assert other.sd == pytest.approx(stretch * one.sd)
        assert one.low < one.mean < one.high


def test_of_several_runs_the_farthest_two_are_named() -> None:
    for row in overlay_rows([layer("a", 0.2), layer("b", -1.0), layer("c", 1.5)]):
        assert row.pair == (1, 2)
        assert row.distance == pytest.approx(2.5)


def test_what_is_held_or_missing_is_no_distance() -> None:
    """One run holds k_e, and knows nothing of k_s."""
    whole = layer("a")
    space = problem().posterior.space
    kept = tuple(s for s in problem().symbols if s.name not in ("k_e", "k_s"))
    fewer = dataclasses.replace(space, fixed={"k_e": 0.06})
    less = dataclasses.replace(
        problem(),
        posterior=dataclasses.replace(problem().posterior, space=fewer),
        symbols=kept,
        nominal={**problem().nominal, "j_1": 0.03},
    )
    columns = [problem().symbols.index(symbol) for symbol in kept]
    other = dataclasses.replace(whole, problem=less, draws=whole.draws[:, columns])
    found = {row.symbol.name: row for row in overlay_rows([whole, other])}
    assert found["k_e"].places[1] is not None
    assert found["k_e"].places[1].fixed
    assert found["k_e"].places[1].mean == 0.06
    assert found["k_s"].places[1] is None
    assert not found["k_e"].shared
    assert found["k_s"].distance is None
    assert found["c_m"].distance == 0.0
    assert found["j_1"].agreed is None  # two nominal values


def test_what_differs_is_what_is_not_the_same_everywhere() -> None:
    found = differing([layer("a", seed="1", k_s="normal"), layer("b", seed="1", k_e="held")])
    assert found == {"k_s": ("normal", None), "k_e": (None, "held")}
