"""Formulas: what they are worth, when they are surely positive, and what they may not say."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from support.case_tables import run_cases

from bayesdrill.basics.duals import Dual
from bayesdrill.basics.formulas import RelationError, expression, resolve_relations

NAMES = ("G", "d", "L", "k_e", "k_s", "j_1")
VALUES = {"G": 79.3e9, "d": 3e-3, "L": 2.4, "k_e": 0.06, "k_s": 0.26, "j_1": 0.0283}
SHAFT = "pi*G*d**4/(32*L)"

WORTH = [
    ("k_e", 0.06),
    (SHAFT, math.pi * 79.3e9 * 3e-3**4 / 76.8),
    ("sqrt(k_s/j_1)", math.sqrt(0.26 / 0.0283)),
    ("-(k_s - 1) + 2 ** -1", 1.24),
    ("exp(log(k_s)*2)", 0.26**2),
    ("k_s**1.5 / d**(1/2)", 0.26**1.5 / 3e-3**0.5),
]


@run_cases("text, value", WORTH)
def test_value_at_numbers_and_at_arrays(text: str, value: float) -> None:
    found = pickle.loads(pickle.dumps(expression(text, NAMES)))
    assert found == expression(text, NAMES)
    assert found.value(VALUES) == pytest.approx(value, rel=1e-14)
    both = {name: np.array([x, x]) for name, x in VALUES.items()}
    assert found.value(both) == pytest.approx([value, value], rel=1e-14)


@run_cases("text", [text for text, _ in WORTH])
def test_derivatives_are_those_of_differences(text: str) -> None:
    """Mutant killed: the slope of a power forgotten."""
    found = expression(text, NAMES)
    for name in found.names:
        dual = found.value({**VALUES, name: Dual(VALUES[name], 1.0)})
        h = 1e-6 * VALUES[name]
        up, down = (found.value({**VALUES, name: VALUES[name] + s}) for s in (h, -h))
        assert dual.slope == pytest.approx((up - down) / (2 * h), rel=1e-7)


def test_what_is_positive_by_its_form_is_so_at_all_positive_numbers() -> None:
    rng = np.random.default_rng(5)
    drawn = {name: np.exp(rng.normal(0, 3, 500)) for name in NAMES}
    for text in (
        SHAFT,
        "k_e",
        "sqrt(k_s/j_1)",
        "k_s/k_s*d**-2",
        "2*pi*(d/L)",
        "(1 + 0.1)*k_e",
        "sqrt(k_s/j_1)*exp(1)",
    ):
        found = expression(text, NAMES)
        assert found.positive
        assert np.all(found.value(drawn) > 0)


def test_what_may_be_negative_or_nothing_is_not_taken_for_positive() -> None:
    for text in (
        "-k_s",
        "k_s - j_1",
        "k_s - k_s",
        "log(k_e)",
        "0*d",
        "sqrt(d - 1)",
        "k_s + j_1",
        "(1 - 2)*d",
        "1e-300*1e-300*d",
        "1e300*1e300*d",
        "1 + d",
        "exp(d)",
    ):
        assert not expression(text, NAMES).positive


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
        ("(" * 300 + "d" + ")" * 300, "not a formula"),
        ("", "not a formula"),
    ],
)
def test_refuses_the_rest_in_words(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        expression(text, NAMES)


def test_chains_are_resolved_and_circles_named() -> None:
    chain = {"k_T": expression("2*k_e", NAMES), "k_e": expression("G + d", NAMES)}
    assert resolve_relations(chain)["k_T"].value(VALUES) == pytest.approx(2 * (79.3e9 + 3e-3))
    circle = {"k_s": expression("j_1", NAMES), "j_1": expression("k_s*2", NAMES)}
    with pytest.raises(RelationError, match="k_s -> j_1 -> k_s"):
        resolve_relations(circle)
