"""Model, noise or neither: what the log evidence of several models of one record says."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from support.case_tables import run_cases
from support.compared_models import model, problem

from bayesdrill.analysis import comparison
from bayesdrill.analysis.comparison import RunSummary, Word, decide, probabilities
from bayesdrill.report.sections import comparison_words

GIVEN = model("given", 0.0)
FRICTION = {"rig": "rubbing"}
RED = {"noise": "ar1"}

CASES: dict[str, tuple[list[RunSummary], Word, str]] = {
    "one thing alone": ([GIVEN, model("b", 2.0, **FRICTION), model("c", 1.0, **RED)], "neither", "b"),
    "the first": ([GIVEN, model("b", -5.0, **FRICTION)], "neither", "given"),
    "by chance": ([GIVEN, model("b", 4.0, **FRICTION, error=1.0)], "neither", "b"),
    "friction": ([GIVEN, model("b", 40.0, **FRICTION), model("c", 20.0, **RED)], "model", "b"),
    "red noise": ([GIVEN, model("b", 20.0, **FRICTION), model("c", 40.0, **RED)], "noise", "c"),
    "nobody knows": ([GIVEN, model("b", 41.0, **FRICTION), model("c", 40.0, **RED)], "either", "b"),
    "both": (
        [GIVEN, model("b", 20.0, **FRICTION), model("c", 30.0, **RED),
         model("d", 60.0, **FRICTION, **RED)], "both", "d",
    ),
    "friction beside red noise that is not needed": (
        [GIVEN, model("b", 59.0, **FRICTION), model("c", 30.0, **RED),
         model("d", 60.0, **FRICTION, **RED)], "model", "d",
    ),
    "red noise beside friction that is not needed": (
        [GIVEN, model("b", 20.0, **FRICTION), model("c", 59.0, **RED),
         model("d", 60.0, **FRICTION, **RED)], "noise", "d",
    ),
    "priors": ([GIVEN, model("b", 10.0)], "priors", "b"),
}  # fmt: skip


@run_cases("models, word, best", CASES.values(), CASES)
def test_the_word_is_that_of_the_odds(models: list[RunSummary], word: Word, best: str) -> None:
    """Mutants killed: the best against the first alone; no standard error."""
    found = decide(models)
    assert (found.word, models[found.best].name) == (word, best)
    said = next(iter(comparison_words.comparison_verdict(models)))
    shown = {"both": "MODEL AND NOISE", "either": "MODEL OR NOISE"}.get(word, word.upper())
    assert said.startswith(f"verdict: {shown}")


def test_odds_are_those_of_the_evidence() -> None:
    shares = probabilities([model("a", -3000.0), model("b", -3000.0 + math.log(3.0))])
    assert shares == pytest.approx((0.25, 0.75))
    assert [comparison_words.odds(x) for x in (0.0, math.log(7.5), math.log(120.4), 35.2)] == [
        "1", "7.5", "120", "e^35",
    ]  # fmt: skip


def test_vague_priors_are_named_where_they_may_have_decided() -> None:
    """Of a model that has lost by little, and not by a prior that the best has too.

    Mutants killed: all vague priors; those of the best.
    """

    def named(*others: RunSummary) -> tuple[str, ...]:
        return decide([model("best", 0.0, vague="k_s"), *others]).vague

    assert named(model("b", -4.0, vague="c_s")) == ("c_s",)
    assert named(model("b", -40.0, vague="c_s")) == ()
    assert named(model("b", -4.0, vague="k_s")) == ()
    assert named(model("b", -4.0, vague="k_s", prior="another")) == ("k_s",)


def test_what_must_not_be_believed_is_said() -> None:
    models = [GIVEN, model("stopped", 30.0, **FRICTION, rms=2.0)]
    said = "\n".join(comparison_words.comparison_verdict(models))
    assert "more than noise: none of these models explains the whole record" in said
    assert "stopped did not converge" in said
    table = comparison_words.comparison_table(models)
    assert [line[0] for line in table.lines] == ["stopped (NOT CONVERGED)", "given"]


def test_a_comparison_names_why_a_model_must_not_be_believed() -> None:
    """Mutants killed: the reasons of the best alone; a warning without its reasons."""
    layer = replace(
        GIVEN.layer, warning="DOES NOT FIT: much", reasons=("w_1 is off", "and coloured")
    )
    said = "\n".join(
        comparison_words.comparison_verdict(
            [replace(GIVEN, layer=layer), model("best", 30.0, **FRICTION)]
        )
    )
    assert (
        "  DO NOT BELIEVE given: DOES NOT FIT: much\n    - w_1 is off\n    - and coloured" in said
    )
    assert "BELIEVE best" not in said


def test_a_table_of_models_without_nominal_values_has_no_column_of_them() -> None:
    """Nor one for how far apart unknowns are that no two of them share."""
    some = problem().symbols
    bare = [replace(problem(), nominal={}, symbols=own) for own in (some[:3], some[3:6])]
    layers = [replace(GIVEN.layer, name=n, problem=p) for n, p in zip("ab", bare, strict=True)]
    heads = comparison_words.overlay_table(layers, comparison.overlay_rows(layers)).heads
    assert heads == ("", "unit", "a", "b")
