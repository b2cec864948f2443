"""What leans on a prior: against draws whose dependence is made."""

from __future__ import annotations

import dataclasses

import numpy as np
from support.case_tables import run_cases

from bayesdrill.analysis.diagnostics import ParameterRow, Word, prior_dependence
from bayesdrill.report import words as said_of

RNG = np.random.default_rng(4)
N = 6000


def row(name: str, word: Word) -> ParameterRow:
    numbers = dict.fromkeys(
        (
            f.name
            for f in dataclasses.fields(ParameterRow)
            if f.name not in ("name", "unit", "word")
        ),
        1.0,
    )
    return ParameterRow(name=name, unit="1", word=word, **numbers)  # type: ignore[arg-type]


A, B, C = RNG.uniform(1.0, 3.0, (3, N))  # left to their priors
NOISE = RNG.standard_normal(N)


@run_cases(
    "draws, on",
    [
        (2.0 - 0.3 * A + 0.01 * NOISE, ("a",)),
        (np.exp(-4 * A) * (1 + 0.01 * NOISE), ("a",)),  # along a bent ridge
        (A * B, ("a", "b")),
        (A + 2.0 * NOISE, None),
        (NOISE, None),
    ],
)
def test_what_others_left_to_their_priors_explain_leans_on_them(
    draws: np.ndarray, on: tuple[str, ...] | None
) -> None:
    """Mutants killed: correlation of values instead of ranks, one partner only, no partner at all."""
    words: tuple[Word, ...] = ("prior only", "determined", "prior only", "prior only")
    rows = [row(name, word) for name, word in zip("axbc", words, strict=True)]
    found = prior_dependence(rows, np.stack([A, draws, B, C], axis=1))
    assert found == ({} if on is None else {"x": on})


def test_only_what_is_called_determined_can_lean_and_only_on_what_is_not_known() -> None:
    draws = np.stack([A, A + 0.01 * NOISE], axis=1)
    assert prior_dependence([row("a", "weak"), row("x", "determined")], draws) == {}
    assert prior_dependence([row("a", "prior only"), row("x", "through others")], draws) == {}


def test_those_that_lean_on_the_same_are_said_together() -> None:
    said = said_of.leaning({"k_s": ("j_1",), "k_e": ("c_m",), "j_m": ("j_1",)})
    first, second = said.splitlines()
    assert first.startswith("leaning: k_s, j_m on the prior of j_1. ")
    assert second.startswith("leaning: k_e on the prior of c_m. ")
    assert said_of.leaning({}) == ""
