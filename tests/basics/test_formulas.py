"""Formulas and linear combinations: their values and slopes, their signs, and what they may not say."""

import math
import pickle

import numpy as np
import pytest
from support.case_tables import run_cases

from bayesdrill.basics.duals import Dual
from bayesdrill.basics.formulas import (
    RelationError,
    expression,
    linear_combination,
    resolve_relations,
)

VALUES = {"G": 79.3e9, "d": 3e-3, "L": 2.4, "k_e": 0.06, "k_s": 0.26, "j_1": 0.0283}
SHAFT = "pi*G*d**4/(32*L)"
FORMULAS = [
    ("k_e", 0.06),
    (SHAFT, math.pi * 79.3e9 * 3e-3**4 / 76.8),
    ("sqrt(k_s/j_1)", math.sqrt(0.26 / 0.0283)),
    ("-(k_s - 1) + 2 ** -1", 1.24),
    ("exp(log(k_s)*2)", 0.26**2),
    ("k_s**1.5 / d**(1/2)", 0.26**1.5 / 3e-3**0.5),
]


@run_cases("text, value", FORMULAS)
def test_a_formula_has_values_at_numbers_and_at_arrays(text: str, value: float) -> None:
    formula = pickle.loads(pickle.dumps(expression(text, VALUES)))
    assert formula == expression(text, VALUES)
    assert formula.value(VALUES) == pytest.approx(value, rel=1e-14)
    arrays = {name: np.array([x, x]) for name, x in VALUES.items()}
    assert formula.value(arrays) == pytest.approx([value, value], rel=1e-14)


@run_cases("text", [text for text, _ in FORMULAS])
def test_derivatives_are_those_of_differences(text: str) -> None:
    formula = expression(text, VALUES)
    for name in formula.names:
        dual = formula.value({**VALUES, name: Dual(VALUES[name], 1.0)})
        h = 1e-6 * VALUES[name]
        up, down = (formula.value({**VALUES, name: VALUES[name] + s}) for s in (h, -h))
        assert dual.slope == pytest.approx((up - down) / (2 * h), rel=1e-7)


POSITIVE = (SHAFT, "k_e", "sqrt(k_s/j_1)", "k_s/k_s*d**-2", "2*pi*(d/L)", "(1 + 0.1)*k_e")
SIGNED = (
    *("-k_s", "k_s - j_1", "k_s - k_s", "log(k_e)", "0*d", "sqrt(d - 1)", "k_s + j_1", "1 + d"),
    *("(1 - 2)*d", "1e-300*1e-300*d", "1e300*1e300*d", "exp(d)"),
)


def test_only_formulas_of_a_positive_form_are_taken_for_positive() -> None:
    rng = np.random.default_rng(5)
    draws = {name: np.exp(rng.normal(0, 3, 500)) for name in VALUES}
    for text in (*POSITIVE, "sqrt(k_s/j_1)*exp(1)"):
        formula = expression(text, VALUES)
        assert formula.positive
        assert np.all(formula.value(draws) > 0)
    assert [text for text in SIGNED if expression(text, VALUES).positive] == []


@run_cases(
    "text, message",
    [
        ("k_x", "did you mean"),
        ("pi*G*d^4", r"d\*\*4"),
        ("sin(d)", "functions are sqrt, exp, log"),
        ("sqrt(d, L)", "of one number each"),
        ("d**L", "the power 'L'|not a known name"),
        ("0,06", "decimal point"),
        ("0.06 N*m", "without units"),
        ("__import__('os').system('x')", "cannot stand"),
        ("d.real", "cannot stand"),
        ("True*d", "cannot stand"),
        ("d*1e999", "not a formula"),
        ("(" * 300 + "d" + ")" * 300, "not a formula"),
        ("", "not a formula"),
    ],
)
def test_text_that_is_no_formula_is_refused_with_a_way_out(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        expression(text, VALUES)


def test_chains_are_resolved_and_circles_named() -> None:
    chain = {"k_T": expression("2*k_e", VALUES), "k_e": expression("G + d", VALUES)}
    assert resolve_relations(chain)["k_T"].value(VALUES) == pytest.approx(2 * (79.3e9 + 3e-3))
    circle = {"k_s": expression("j_1", VALUES), "j_1": expression("k_s*2", VALUES)}
    with pytest.raises(RelationError, match="k_s -> j_1 -> k_s"):
        resolve_relations(circle)


STATES = ("theta_1", "theta_2", "w_1", "w_2", "i")


@run_cases(
    "text, weights",
    [
        ("theta_1", {"theta_1": 1.0}),
        ("theta_1 - theta_2", {"theta_1": 1.0, "theta_2": -1.0}),
        ("8 * theta_2", {"theta_2": 8.0}),
        ("w_2 / 0.125", {"w_2": 8.0}),
        ("-(theta_2 - theta_1) * 2", {"theta_1": 2.0, "theta_2": -2.0}),
        ("+w_1 + w_1 - 3*w_2 - w_1", {"w_1": 1.0, "w_2": -3.0}),
        ("(1 + 1) * i / (3 - 1)", {"i": 1.0}),
    ],
)
def test_linear_combinations_have_weights(text: str, weights: dict[str, float]) -> None:
    assert linear_combination(text, STATES) == weights


@run_cases(
    "text, message",
    [
        ("theta_3", "did you mean theta_2|did you mean theta_1"),
        *((text, "not linear") for text in ("theta_1 * theta_2", "sin(theta_1)", "1 / w_1")),
        *((text, "not linear") for text in ("w_1 / 0", "__import__('os')", "True * w_1")),
        ("theta_1 + 1", "constant term"),
        ("theta_1 - theta_1", "is zero"),
        ("theta_1 -", "not a formula"),
        ("", "not a formula"),
    ],
)
def test_text_that_is_no_linear_combination_is_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        linear_combination(text, STATES)
