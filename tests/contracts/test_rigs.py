"""Every rig has symbols, entries of a config and exact responses, alone and with all that it offers."""

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment

from bayesdrill.basics import symbols
from bayesdrill.basics.entries import build_member, entries_of
from bayesdrill.config.schema.config import ModelSpec
from bayesdrill.config.schema.validation import named_entries
from bayesdrill.config.schema.vocabulary import vocabulary_of
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.friction import DIRECTION
from bayesdrill.rig.models.linear import Model, dynamics, with_all
from bayesdrill.rig.simulators.linear import Response

N, DT = 40, 0.004
POINT = np.exp(np.random.default_rng(7).uniform(-0.2, 0.2, 50))
CONSTANT = {"v": 8.0, "t_1": 0.1, "w_2": 6.0, "t_m": 0.2, "wob": 400.0}
PLAIN = {name: kind() for name, kind in MODELS.items()}
WHOLE = {f"{name} with all": with_all(rig) for name, rig in PLAIN.items() if rig.offers}
RIGS: dict[str, Model] = PLAIN | WHOLE
# Structures take long to compile: a rig with all that it offers has all formulas of the plain one.
LARGEST = {name: rig for name, rig in RIGS.items() if f"{name} with all" not in WHOLE}


def values(rig: Model) -> np.ndarray:
    """Return parameters `(1, P)`: near nominal, and small numbers where there is no nominal value."""
    usual = [NOMINAL.get(name, 2e-3) for name in rig.parameters]
    return np.array([usual]) * POINT[: len(usual)]


@cache
def response(name: str) -> Response:
    """Return that of a rig, with few states where it has a number of them: they take long to compile."""
    rig: Any = RIGS[name]
    rig = dataclasses.replace(rig, elements=2) if hasattr(rig, "elements") else rig
    measures = {state: {state: 1.0} for state in rig.states}
    constant = {name: CONSTANT[name] for name in rig.inputs}
    return Response(rig, experiment(N, DT, constant=constant, measures=measures))


@run_cases("name", RIGS)
def test_its_names_have_symbols_and_entries_of_a_config(name: str) -> None:
    rig = RIGS[name]
    kind: Any = type(rig)
    assert rig.name == kind.name == name.removesuffix(" with all")
    words = vocabulary_of(rig)
    entries = named_entries(words)
    assert {*rig.parameters} <= {*words.parameters} == {*entries["parameters",]}
    assert {*rig.states} <= {*words.states}
    assert {*rig.inputs} <= {*words.inputs} <= {*entries["inputs",]}
    whole = RIGS.get(f"{rig.name} with all", rig)  # states of an added mode are declared too
    shared = {*rig.parameters, *rig.offers, *whole.states}
    known = {*rig.symbols} if rig.has_private_names else shared
    assert {symbol.name for symbol in rig.declares} <= known
    fields = {field.name for field in dataclasses.fields(kind)} - {"added"}
    assert fields == {*entries_of(kind)} <= {*ModelSpec.model_fields}
    assert build_member(kind, ModelSpec(name=rig.name)) == kind() == PLAIN[rig.name]
    assert rig.parameters == (*kind().parameters, *rig.added)
    assert {*rig.offers} == {*rig.parameters} - {*kind().parameters} or rig == kind()
    assert {name for needs in rig.offers.values() for name in needs} <= {*rig.offers}
    hash(rig)


@run_cases("name", RIGS)
def test_its_frictions_brake_and_have_names_of_their_own(name: str) -> None:
    rig = RIGS[name]
    p = dict(zip(rig.parameters, values(rig)[0], strict=True))
    frictions, columns = rig.frictions, rig.linear(p).B
    names = [friction.name for friction in frictions]
    taken = [*names, *rig.parameters, *dict.fromkeys([*rig.states, *symbols.INPUTS])]
    assert len({*taken}) == len(taken)
    assert {name for _, name in columns} <= {*rig.inputs, *names}
    for friction in frictions:
        law, rows = friction.law, {row for row, column in columns if column == friction.name}
        assert friction.against in rows <= {friction.against, *rig.inner}
        assert columns[friction.against, friction.name] < 0
        assert friction.holds is None or friction.holds in rig.angles
        assert {*law.parameters} <= {*rig.parameters}
        assert {*law.seen} <= {*rig.states, *rig.inputs, DIRECTION}
        assert friction.where
        seen = {state: np.array([0.3, -0.2]) for state in law.seen}
        for speed in (0.0, 1e-3, 2.0, 1e3):
            size = np.broadcast_to(law.size(p, np.full(2, speed), seen), 2)
            assert ((size >= 0) & np.isfinite(size)).all()


def course(name: str, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return signals and slopes by each parameter times itself; both are of one kernel."""
    signals, slopes = response(name).course(p, np.diag(p[0])[None])
    return signals[0], slopes[0]


@run_cases("name", LARGEST)
def test_its_response_is_the_matrix_exponential(name: str) -> None:
    rig = response(name).model
    p = values(rig)
    linear = rig.linear(dict(zip(rig.parameters, p[0], strict=True)))
    states = list(rig.states)
    augmented = np.zeros((len(states) + 1, len(states) + 1))
    augmented[:-1, :-1] = dynamics(linear, rig.states, 1)[0]
    for row, value in linear.c.items():
        augmented[states.index(row), -1] += value
    for (row, column), value in linear.B.items():
        if column in rig.inputs:
            augmented[states.index(row), -1] += CONSTANT[column] * value
    step, x = expm(augmented * DT), np.append(np.zeros(len(states)), 1.0)
    exact = np.empty((N, len(states)))
    for k in range(N):
        exact[k], x = x[:-1], step @ x
    scale = np.abs(exact).max(axis=0)
    scale[scale == 0] = 1.0  # what nothing moves
    assert course(name, p)[0] / scale == pytest.approx(exact / scale, abs=1e-9)


@run_cases("name", LARGEST)
def test_its_sensitivities_are_differences(name: str) -> None:
    rig = response(name).model
    p = values(rig)
    slopes = course(name, p)[1]
    for k, parameter in enumerate(rig.parameters):
        step = 1e-5 * p * (np.arange(p.shape[1]) == k)
        numeric = (course(name, p + step)[0] - course(name, p - step)[0]) / 2e-5
        scale = np.abs(numeric).max() + 1e-9
        assert slopes[k] / scale == pytest.approx(numeric / scale, abs=1e-4), parameter
