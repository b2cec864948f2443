"""What holds of every figure of a run: it is drawn, with words on its axes, and its files are known."""

from __future__ import annotations

import pickle
from functools import cache

import numpy as np
import pytest
from oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.basics import own_files
from bayesdrill.basics.own_files import POSTERIOR
from bayesdrill.report.figures import FIGURES

T = np.linspace(0.0, 4.0, 161)
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}


@cache
def run() -> bd.Run:
    """Of a rig in which one symmetry is left, so that every figure has something to show."""
    exact = bd.respond("motor_shaft", {**NOMINAL, "k_s": 0.29}, T, {"v": 6.0}, "w_2")["w_2"]
    noise = 0.1 * np.random.default_rng(6).standard_normal(len(T))
    case = bd.case(
        T,
        channels={"w_2": bd.Channel(exact + noise, "rad/s", 0.1)},
        inputs={"v": 6.0},
        parameters=dict.fromkeys(NOMINAL, "nominal") | dict.fromkeys(("r_m", "k_T", "l_m"), BOX),
        sampler={"ensembles": 4, "walkers": 32, "ess": 400},
        seed=3,
    )
    return case.sample()


@pytest.mark.parametrize("name", FIGURES)
def test_it_is_drawn_and_says_what_it_shows(name: str) -> None:
    drawing = FIGURES[name](run()._view)
    assert drawing is not None
    other = pickle.loads(pickle.dumps(drawing))  # as a worker gets it
    figure = other.figure(*other.arguments)
    assert figure.axes
    labels = [axes.get_xlabel() + axes.get_ylabel() for axes in figure.axes]
    assert any(labels)
    for end in ("pdf", "png"):
        assert POSTERIOR.made(f"{own_files.FIGURES}/{name}.{end}")
