from __future__ import annotations

import pytest
from support.case_tables import run_cases

from bayesdrill.basics.formulas import linear_combination

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
def test_reads_linear_combinations(text: str, weights: dict[str, float]) -> None:
    assert linear_combination(text, STATES) == weights


@run_cases(
    "text, message",
    [
        ("theta_3", "did you mean theta_2|did you mean theta_1"),
        ("theta_1 * theta_2", "not linear"),
        ("sin(theta_1)", "not linear"),
        ("theta_1 + 1", "constant term"),
        ("theta_1 - theta_1", "is zero"),
        ("1 / w_1", "not linear"),
        ("w_1 / 0", "not linear"),
        ("theta_1 -", "not a formula"),
        ("", "not a formula"),
        ("__import__('os')", "not linear"),
        ("True * w_1", "not linear"),
    ],
)
def test_refuses_the_rest_in_words(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        linear_combination(text, STATES)
