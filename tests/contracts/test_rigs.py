"""What holds of every rig: names with symbols, exact responses and slopes, entries of a config; each as
it is, and with all that it offers.

Mutants killed: a parameter without a symbol, a slope of another rig, a constant that no config gives, a
friction that drives.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment

from bayesdrill.basics import symbols
from bayesdrill.basics.entries import build_member, entries_of
from bayesdrill.config.schema.config import ModelSpec, config_kind
from bayesdrill.config.schema.vocabulary import vocabulary_of
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import Model, dynamics, with_all
from bayesdrill.rig.simulators.linear import Response

N, DT = 40, 0.004
POINT = np.exp(np.random.default_rng(7).uniform(-0.2, 0.2, 50))

PLAIN = {name: kind() for name, kind in MODELS.items()}
WHOLE = {f"{name} with all": with_all(rig) for name, rig in PLAIN.items() if rig.offers}
RIGS: dict[str, Model] = PLAIN | WHOLE


def light(name: str) -> Model:
    """With fewer states, where it has a number of them: for kernels, which take long to compile."""
    rig: Any = RIGS[name]
    return dataclasses.replace(rig, elements=2) if hasattr(rig, "elements") else rig


CONSTANT = {"v": 8.0, "t_1": 0.1, "w_2": 6.0, "t_m": 0.2, "wob": 400.0}


def values(rig: Model) -> np.ndarray:
    """`(1, P)`: near nominal; of other parameters a small number."""
    usual = [NOMINAL.get(name, 2e-3) for name in rig.parameters]
    return np.array([usual]) * POINT[: len(usual)]


def response(rig: Model) -> Response:
    measures = {name: {name: 1.0} for name in rig.states}
    constant = {name: CONSTANT[name] for name in rig.inputs}
    return Response(rig, experiment(N, DT, constant=constant, measures=measures))


@run_cases("name", RIGS)
def test_its_names_have_symbols_and_places_in_a_config(name: str) -> None:
    rig = RIGS[name]
    kind: Any = type(rig)
    assert rig.name == kind.name == name.removesuffix(" with all")
    words = vocabulary_of(rig)
    sections = config_kind(words).model_fields
    assert (
        {*rig.parameters}
        <= {*words.parameters}
        == {*sections["parameters"].annotation.__annotations__}
    )
    assert {*rig.states} <= {*words.states}
    assert {*rig.inputs} <= {*words.inputs} <= {*sections["inputs"].annotation.model_fields}
    shared = {*rig.parameters, *rig.offers, *rig.states}
    assert {one.name for one in rig.declares} <= {
        *(rig.symbols if rig.has_private_names else shared)
    }
    fields = {field.name for field in dataclasses.fields(kind)} - {"added"}
    assert fields == {*entries_of(kind)} <= {*ModelSpec.model_fields}
    assert build_member(kind, ModelSpec(name=rig.name)) == kind() == PLAIN[rig.name]
    assert rig.parameters == (*kind().parameters, *rig.added)
    assert {*rig.offers} == {*rig.parameters} - {*kind().parameters} or rig == kind()
    assert {name for needs in rig.offers.values() for name in needs} <= {*rig.offers}
    hash(rig)


@run_cases("name", RIGS)
def test_its_frictions_brake_and_are_told_apart(name: str) -> None:
    rig, p = RIGS[name], values(RIGS[name])[0]
    named = dict(zip(rig.parameters, p, strict=True))
    frictions, columns = rig.frictions, rig.linear(named).B
    names = [one.name for one in frictions]
    taken = [*names, *rig.parameters, *dict.fromkeys([*rig.states, *symbols.INPUTS])]
    assert len({*taken}) == len(taken)
    assert {name for _, name in columns} <= {*rig.inputs, *names}
    for one in frictions:
        rows = {row for row, column in columns if column == one.name}
        assert one.against in rows <= {one.against, *rig.inner}
        assert columns[one.against, one.name] < 0
        assert one.holds is None or one.holds in rig.angles
        assert {*one.law.parameters} <= {*rig.parameters}
        assert {*one.law.seen} <= {*rig.states, *rig.inputs}
        assert one.where
        seen = {state: np.array([0.3, -0.2]) for state in one.law.seen}
        for speed in (0.0, 1e-3, 2.0, 1e3):
            size = np.broadcast_to(one.law.size(named, np.full(2, speed), seen), 2)
            assert ((size >= 0) & np.isfinite(size)).all()


@run_cases("name", RIGS)
def test_its_response_is_the_matrix_exponential(name: str) -> None:
    rig, p = light(name), values(light(name))
    named = dict(zip(rig.parameters, p[0], strict=True))
    linear = rig.linear(named)
    states = list(rig.states)
    augmented = np.zeros((len(states) + 1, len(states) + 1))
    augmented[:-1, :-1] = dynamics(linear, rig.states, 1)[0]
    for row, value in linear.c.items():
        augmented[states.index(row), -1] += value
    for (row, name_), value in linear.B.items():
        if name_ in rig.inputs:
            augmented[states.index(row), -1] += CONSTANT[name_] * value
    x = np.zeros(len(states) + 1)
    x[-1] = 1.0
    step, exact = expm(augmented * DT), []
    for _ in range(N):
        exact.append(x[:-1])
        x = step @ x
    found = response(rig).signals(p)[0]
    scale = np.abs(exact).max(axis=0)
    scale[scale == 0] = 1.0  # what nothing moves
    assert found / scale == pytest.approx(np.array(exact) / scale, abs=1e-9)


@run_cases("name", RIGS)
def test_its_sensitivities_are_differences(name: str) -> None:
    rig, p = light(name), values(light(name))
    of = response(rig)
    along = np.diag(p[0])[None]
    slopes = of.sensitivities(p, along)[0]
    for k, name_ in enumerate(rig.parameters):
        up, down = p.copy(), p.copy()
        up[0, k], down[0, k] = p[0, k] * (1 + 1e-5), p[0, k] * (1 - 1e-5)
        numeric = (of.signals(up) - of.signals(down))[0] / 2e-5
        scale = np.abs(numeric).max() + 1e-9
        assert slopes[k] / scale == pytest.approx(numeric / scale, abs=1e-4), name_


@run_cases("name", RIGS)
def test_its_sums_are_those_of_its_signals(name: str) -> None:
    rig, p = light(name), values(light(name))
    of = response(rig)
    y = 1.01 * of.signals(p)[0] + 0.1
    of = of.with_record(y)
    left, k = y - of.signals(p)[0], y.shape[1]
    assert of.squares(p)[0] == pytest.approx((left**2).sum(axis=0), rel=1e-9)
    scales = np.linspace(0.5, 3.0, k)[None]
    along = np.random.default_rng(2).standard_normal((1, 3, p.shape[1])) * p
    shifts = of.sensitivities(p, along)[0] * scales[0]
    squares, pulled, products = of.normal(p, along, scales[..., None] ** 2)
    assert squares[0] == pytest.approx((left**2).sum(axis=0) * scales[0] ** 2, rel=1e-9)
    assert pulled[0] == pytest.approx(np.einsum("qtk,tk->q", shifts, left * scales[0]), rel=1e-7)
    assert products[0] == pytest.approx(np.einsum("qtk,rtk->qr", shifts, shifts), rel=1e-7)
