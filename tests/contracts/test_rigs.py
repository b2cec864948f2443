"""What holds of every rig: names with symbols, exact responses and slopes, entries of a config.

Mutants killed: a parameter without a symbol, a slope of another rig, a constant that no config gives.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from oracles import NOMINAL
from rigs import experiment
from scipy.linalg import expm

from bayesdrill.basics import symbols
from bayesdrill.basics.entries import entries_of, made
from bayesdrill.rig import vocabulary
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import Model, dynamics
from bayesdrill.rig.response import Response
from bayesdrill.setup.config import ModelSpec, Parameters

N, DT = 40, 0.004
POINT = np.exp(np.random.default_rng(7).uniform(-0.2, 0.2, 20))


def values(rig: type[Model]) -> np.ndarray:
    """`(1, P)`: near nominal; of its own parameters a small number."""
    usual = [NOMINAL.get(name, 2e-3) for name in rig.parameters]
    return np.array([usual]) * POINT[: len(usual)]


def response(rig: type[Model]) -> Response:
    measures = {name: {name: 1.0} for name in rig.states}
    return Response(rig(), experiment(N, DT, measures=measures))


@pytest.mark.parametrize("name", MODELS)
def test_its_names_have_symbols_and_places_in_a_config(name: str) -> None:
    rig = MODELS[name]
    assert rig.name == name
    assert {*rig.parameters} <= {*vocabulary.PARAMETERS} & {*Parameters.model_fields}
    assert {*rig.states} <= {*vocabulary.STATES}
    assert {*rig.inputs} <= {*symbols.INPUTS}
    assert {one.name for one in rig.declares} <= {*rig.parameters, *rig.states}
    fields = {field.name for field in dataclasses.fields(rig)}
    assert fields == {*entries_of(rig)} <= {*ModelSpec.model_fields}
    assert made(rig, ModelSpec(name=name)) == rig()
    hash(rig())


@pytest.mark.parametrize("name", MODELS)
def test_its_response_is_the_matrix_exponential(name: str) -> None:
    rig, p = MODELS[name], values(MODELS[name])
    named = dict(zip(rig.parameters, p[0], strict=True))
    linear = rig().linear(named)
    states = list(rig.states)
    augmented = np.zeros((len(states) + 1, len(states) + 1))
    augmented[:-1, :-1] = dynamics(linear, rig.states, 1)[0]
    for row, value in linear.c.items():
        augmented[states.index(row), -1] += value
    for (row, _), value in ((key, v) for key, v in linear.B.items() if key[1] == "v"):
        augmented[states.index(row), -1] += 8.0 * value
    x = np.zeros(len(states) + 1)
    x[-1] = 1.0
    step, exact = expm(augmented * DT), []
    for _ in range(N):
        exact.append(x[:-1])
        x = step @ x
    found = response(rig).signals(p)[0]
    scale = np.abs(exact).max(axis=0)
    assert found / scale == pytest.approx(np.array(exact) / scale, abs=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_its_sensitivities_are_differences(name: str) -> None:
    rig, p = MODELS[name], values(MODELS[name])
    of = response(rig)
    along = np.diag(p[0])[None]
    slopes = of.sensitivities(p, along)[0]
    for k, name_ in enumerate(rig.parameters):
        up, down = p.copy(), p.copy()
        up[0, k], down[0, k] = p[0, k] * (1 + 1e-5), p[0, k] * (1 - 1e-5)
        numeric = (of.signals(up) - of.signals(down))[0] / 2e-5
        scale = np.abs(numeric).max() + 1e-9
        assert slopes[k] / scale == pytest.approx(numeric / scale, abs=1e-4), name_


@pytest.mark.parametrize("name", MODELS)
def test_its_sums_are_those_of_its_signals(name: str) -> None:
    rig, p = MODELS[name], values(MODELS[name])
    of = response(rig)
    y = 1.01 * of.signals(p)[0] + 0.1
    of = of.with_record(y)
    left, k = y - of.signals(p)[0], y.shape[1]
    assert of.squares(p)[0] == pytest.approx((left**2).sum(axis=0), rel=1e-9)
    scales = np.linspace(0.5, 3.0, k)[None]
    along = np.random.default_rng(2).standard_normal((1, 3, p.shape[1])) * p
    shifts = of.sensitivities(p, along)[0] * scales[0]
    squares, pulled, products = of.normal(p, along, scales)
    assert squares[0] == pytest.approx((left**2).sum(axis=0) * scales[0] ** 2, rel=1e-9)
    assert pulled[0] == pytest.approx(np.einsum("qtk,tk->q", shifts, left * scales[0]), rel=1e-7)
    assert products[0] == pytest.approx(np.einsum("qtk,rtk->qr", shifts, shifts), rel=1e-7)
