"""The verdict against what is known exactly: Gaussian posteriors, analytic tails and entropies."""

from __future__ import annotations

import csv
import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import chi2, norm
from support.case_tables import run_cases
from support.linear_study import LINEAR, PRIOR, PRIOR_SD, TABLE, gaussian, linear_study, verdict

from bayesdrill.analysis.diagnostics import ParameterRow
from bayesdrill.analysis.verdict import (
    FALSE_ALARM,
    Verdict,
    bits_gained,
    joint_tension,
    judge,
    reconciled,
    tension,
)
from bayesdrill.basics.symbols import PARAMETERS
from bayesdrill.config.resolve.quantities import nominal_table
from bayesdrill.config.schema.config import Nominal, Thresholds
from bayesdrill.config.schema.vocabulary import HOUSE
from bayesdrill.report.sections import verdict_words
from bayesdrill.tasks import run_entries

N = 4000
NORMAL = norm.ppf((np.arange(N) + 0.5) / N)
RNG = np.random.default_rng(7)


@run_cases("z", [0.3, 1.0, 2.4, 4.0, 12.0])
def test_tension_of_a_normal_posterior_is_its_z(z: float) -> None:
    assert tension(0.02 * (NORMAL - z), 0.0, 0.0) == pytest.approx(z, rel=0.02)
    assert tension(0.02 * (NORMAL + z), 0.0, 0.0) == pytest.approx(z, rel=0.02)


def test_tension_of_a_skewed_posterior_is_its_tail_probability() -> None:
    """Mutant killed: one sd for both sides."""
    exponential = -np.log(1 - (np.arange(N) + 0.5) / N)
    for x in (0.02, 0.2, 3.0):
        tail = math.exp(-x) if x > math.log(2) else -math.expm1(-x)
        assert tension(exponential - x, 0.0, 0.0) == pytest.approx(norm.isf(tail), abs=0.03)


def test_tension_counts_from_the_nearest_value_within_tolerance() -> None:
    """Mutant killed: the tolerance is forgotten."""
    draws = 0.1 + 0.01 * NORMAL
    assert tension(draws, -0.05, 0.05) == pytest.approx(5.0, rel=0.02)
    assert tension(draws, -0.2, 0.2) == 0.0


@run_cases("shift", [0.5, 1.5, 4.0])
def test_joint_tension_is_that_of_chi_squared(shift: float) -> None:
    root = np.array([[1.0, 0.0, 0.0], [0.9, 0.1, 0.0], [2.0, 0.3, 0.02]])
    z = RNG.standard_normal((20_000, 3))
    z = (z - z.mean(axis=0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(z.T))).T
    draws = (z + shift / math.sqrt(3)) @ root.T
    expected = norm.isf(0.5 * chi2.sf(shift**2, 3))
    assert joint_tension(draws, np.eye(3), np.zeros((3, 2))) == pytest.approx(expected, abs=0.06)


def test_joint_tension_vanishes_within_tolerance_only_if_the_factors_can_explain_it() -> None:
    """One factor in both products cannot be off up in the one and down in the other."""
    powers = np.array([[1.0, -1.0], [1.0, 1.0]])
    draws = 0.01 * RNG.standard_normal((N, 2)) + [0.04, 0.06]  # factors 5 % up and 1 % up
    assert joint_tension(draws, powers, np.array([[-0.1, 0.1], [-0.1, 0.1]])) < 0.1
    assert joint_tension(draws, powers, np.array([[-0.02, 0.02], [-0.02, 0.02]])) > 2.0


def test_very_far_is_a_number() -> None:
    draws = 1e-4 * RNG.standard_normal((N, 2)) + 0.5
    found = joint_tension(draws, np.eye(2), np.zeros((2, 2)))
    assert found == pytest.approx(math.sqrt(2) * 0.5 / 1e-4, rel=0.05)


@run_cases("sd", [0.03, 1e-4])
def test_bits_of_a_normal_in_a_flat_prior(sd: float) -> None:
    prior = RNG.uniform(-1.0, 1.0, 100_000)
    exact = (math.log(2.0) - 0.5 * math.log(2 * math.pi * math.e) - math.log(sd)) / math.log(2)
    assert bits_gained(sd * RNG.standard_normal(N), prior) == pytest.approx(exact, abs=0.1)


def test_a_posterior_that_is_the_prior_gains_no_bits() -> None:
    prior = RNG.normal(0.0, 1.0, 100_000)
    assert bits_gained(RNG.normal(0.0, 1.0, N), prior) < 0.05
    assert bits_gained(RNG.normal(0.0, 0.5, N), prior) == pytest.approx(0.459, abs=0.05)


def says(found: Verdict) -> dict[tuple[int, ...], str]:
    return {q.exponents: q.says for q in (*found.products, *found.parameters)}


@pytest.mark.slow
def test_a_nominal_rig_is_rarely_said_to_disagree() -> None:
    """At most 1 % of records; the limit below is passed by chance once in 3000 such tests.

    Mutant killed: 3 sigma become 2.
    """
    rng = np.random.default_rng(11)
    wrong = sum(not verdict(gaussian(TABLE, rng, 1000)).agrees for _ in range(250))
    assert wrong <= 9  # binomial(250, 0.01)


def test_determined_parameters_that_are_off_disagree_and_blind_ones_say_so() -> None:
    """Mutant killed: what lies along a symmetry is judged as well."""
    off = {**TABLE, "r_m": 1.2 * TABLE["r_m"], "k_s": 1.2 * TABLE["k_s"]}
    found = verdict(gaussian(off, np.random.default_rng(2)))
    assert says(found) == {
        (0, 0, 1): "disagrees",
        (1, -1, 0): "disagrees",
        (1, 0, 0): "not determined",
        (0, 1, 0): "not determined",
    }
    assert found.joint is not None
    assert found.joint > 8
    assert not found.agrees


def test_a_fit_that_is_not_noise_leaves_the_table_in_doubt() -> None:
    """Mutant killed: a verdict that does not ask for the fit."""
    off = {**TABLE, "r_m": 1.2 * TABLE["r_m"]}
    draws = gaussian(off, np.random.default_rng(2))
    sure, doubtful = verdict(draws), verdict(draws, fits=False)
    assert says(sure)[0, 0, 1] == "disagrees"
    assert says(doubtful)[0, 0, 1] == "in doubt"
    assert not doubtful.saying("disagrees")
    assert {k: x for k, x in says(sure).items() if x != "disagrees"} == {
        k: x for k, x in says(doubtful).items() if x != "in doubt"
    }
    text = verdict_words.verdict_sentences(doubtful, "table")
    assert "These would, if the model were right, disagree with table: r_m (" in text
    assert "IN DOUBT: the verdict holds only if the model does" in text
    assert run_entries.verdict_data(doubtful, "table")["agrees"] is None
    assert "IN DOUBT" not in verdict_words.verdict_sentences(sure, "table")
    assert run_entries.verdict_data(sure, "table")["agrees"] is False


def test_a_table_agrees_only_with_a_fit_that_is_noise() -> None:
    """Mutant killed: *all agree*, by a model that the fit speaks against."""
    draws = gaussian(TABLE, np.random.default_rng(3))
    assert "All 2 agree with table" in verdict_words.verdict_sentences(verdict(draws), "table")
    found = verdict(draws, fits=False)
    text = verdict_words.verdict_sentences(found, "table")
    assert "If the model were right, all 2 would agree with table" in text
    assert "IN DOUBT" in text
    for converged, why in ((True, "the model does not fit"), (False, "the run did not converge")):
        text = verdict_words.verdict_sentences(found, "table", converged=converged, believed=False)
        assert text == f"verdict: none, because {why}. The numbers may be wrong."
        data = run_entries.verdict_data(found, "table", converged=converged, believed=False)
        assert (data["sentence"], data["agrees"]) == (text, None)


def test_the_corners_of_a_prior_determine_nothing() -> None:
    """Draws along a symmetry however narrow are not the record's doing.

    Mutant killed: only the width of the posterior counts.
    """
    common = 1.4 + 0.01 * RNG.standard_normal(N)
    draws = np.stack([common, common * (1 + 0.01 * RNG.standard_normal(N)), 1 + 0.02 * NORMAL], -1)
    found = verdict(draws * list(TABLE.values()))
    assert says(found)[1, 0, 0] == says(found)[0, 1, 0] == "not determined"


def test_a_weighed_part_settles_what_the_symmetry_hides() -> None:
    """With j_1 known to 1 % beforehand, k_s follows from k_s/j_1; j_1 itself is not the record's.

    Mutant killed: whatever lies along a symmetry is never judged.
    """
    found = linear_study(np.array([PRIOR_SD, 0.01, PRIOR_SD]))
    rng = np.random.default_rng(9)
    widths = np.array([PRIOR_SD, 0.01, PRIOR_SD])
    prior = np.exp(widths * rng.standard_normal((N, 3))) * list(TABLE.values())
    j_1 = np.exp(0.01 * rng.standard_normal(N))
    k_s = 1.2 * j_1 * np.exp(0.01 * rng.standard_normal(N))
    draws = np.stack([k_s, j_1, 1 + 0.02 * rng.standard_normal(N)], -1) * list(TABLE.values())
    judged = judge(found, draws, prior, TABLE, {}, (), Thresholds())
    assert says(judged)[1, 0, 0] == "disagrees"
    assert says(judged)[0, 1, 0] == "not determined"


def test_a_deviation_within_tolerance_agrees() -> None:
    off = {**TABLE, "r_m": 1.1 * TABLE["r_m"]}
    draws = gaussian(off, np.random.default_rng(4))
    assert says(verdict(draws))[0, 0, 1] == "disagrees"
    tolerant = verdict(draws, tolerance=0.2)
    assert tolerant.agrees
    (r_m,) = (q for q in tolerant.parameters if q.exponents == (0, 0, 1))
    assert r_m.beyond is not None
    assert r_m.beyond < 0.01


@run_cases("ratio", [0.55, 0.6, 1.9, 2.1])
def test_the_ends_of_a_tolerance_change_places_below_the_line(ratio: float) -> None:
    """k_s within 20 %, j_1 within 40 %: k_s/j_1 from 0.8/1.4 to 1.2/0.6.

    Mutant killed: the power of j_1 without its sign.
    """
    draws = gaussian({**TABLE, "k_s": ratio * TABLE["k_s"]}, np.random.default_rng(4))
    allowed = {"k_s": 0.2, "j_1": 0.4}
    wide = np.exp(2.0 * np.log(PRIOR / [*TABLE.values()])) * [*TABLE.values()]
    found = judge(LINEAR, draws, wide, TABLE, allowed, (), Thresholds())
    (product,) = (q for q in found.products if q.exponents == (1, -1, 0))
    assert product.tolerance == pytest.approx((0.8 / 1.4 - 1.0, 1.2 / 0.6 - 1.0))
    within = 0.8 / 1.4 < ratio < 1.2 / 0.6
    assert product.says == ("agrees" if within else "disagrees")
    assert found.agrees == within


def test_a_parameter_pressed_against_its_prior_says_so_before_all_else() -> None:
    found = verdict(gaussian(TABLE, np.random.default_rng(5)), pressed=("r_m", "k_s"))
    assert says(found)[0, 0, 1] == says(found)[1, 0, 0] == "pressed against the prior"
    assert says(found)[1, -1, 0] == "agrees"


def cut(exponent: float) -> Verdict:
    """A verdict on a rig of which r_m has a prior that begins at its nominal value.

    `exponent`: how k_s/j_1 follows r_m in the posterior.
    """
    r_m, ratio, other = np.abs(0.02 * NORMAL), 0.01 * NORMAL[::-1], 0.1 * RNG.standard_normal(N)
    k_s = other + ratio + exponent * r_m
    draws = np.exp(np.stack([k_s, other, r_m], -1)) * list(TABLE.values())
    ends = {"r_m": TABLE["r_m"]}
    return judge(LINEAR, draws, PRIOR, TABLE, {}, ("r_m",), Thresholds(), ends)


def test_what_an_end_at_its_nominal_value_cuts_off_cannot_be_judged() -> None:
    """Mutants killed: it disagrees; so does what it dominates; what it leaves alone is not judged."""
    apart, dominated = cut(0.0), cut(3.0)
    assert says(apart)[0, 0, 1] == says(dominated)[0, 0, 1] == "cannot judge"
    assert says(apart)[1, -1, 0] == "agrees"
    assert says(dominated)[1, -1, 0] == "cannot judge"
    assert apart.joint is dominated.joint is None
    text = verdict_words.verdict_sentences(apart, "table")
    assert "Cannot judge: r_m. The prior of r_m ends at 0.33; widen it." in text
    assert "It agrees with table" in text
    text = verdict_words.verdict_sentences(dominated, "table")
    assert "none of the 2 independent products" in text
    assert "Cannot judge: " in text
    assert run_entries.verdict_data(apart, "table")["agrees"] is True
    assert run_entries.verdict_data(dominated, "table")["agrees"] is None


def test_deviation_is_that_of_the_paper_and_an_unknown_without_nominal_is_left_out() -> None:
    draws = gaussian(TABLE, np.random.default_rng(6))
    table = {name: TABLE[name] for name in ("k_s", "j_1")}
    found = judge(LINEAR, draws, PRIOR, table, {}, (), Thresholds())
    assert [q.exponents for q in found.parameters] == [(1, 0, 0), (0, 1, 0)]
    assert [q.exponents for q in found.products] == [(1, -1, 0)]
    assert found.parameters[0].deviation == pytest.approx(draws[:, 0].mean() / TABLE["k_s"] - 1)


def test_words_name_what_disagrees_and_what_nobody_can_know() -> None:
    off = {**TABLE, "r_m": 1.2 * TABLE["r_m"]}
    found = verdict(gaussian(off, np.random.default_rng(2)))
    text = verdict_words.verdict_sentences(found, "tables_2_3")
    first, second = text.splitlines()
    assert "determines 2 of the 2 independent products" in first
    assert "These disagree with tables_2_3: r_m (+" in first
    assert "Not determined by themselves: k_s, j_1" in second
    data = run_entries.verdict_data(found, "tables_2_3")
    assert not data["agrees"]
    assert data["quantities"]["r_m"]["says"] == "disagrees"
    every = list(
        csv.DictReader(verdict_words.verdict_csv(found, [*PARAMETERS.values()]).splitlines())
    )
    units = {row["quantity"]: row["unit"] for row in every}
    assert len(every) == 4
    assert (units["r_m"], units["k_s/j_1"]) == ("ohm", "(N*m/rad)*(kg*m**2)**-1")


def test_together_too_far_is_told_though_each_agrees() -> None:
    found = dataclasses.replace(verdict(gaussian(TABLE, np.random.default_rng(3))), joint=9.0)
    assert not found.agrees
    assert "does not describe this rig" in verdict_words.verdict_sentences(found, "table_1")


def test_false_alarms_are_shared_by_all_that_is_judged() -> None:
    found = verdict(gaussian(TABLE, np.random.default_rng(3)))
    judged = len(found.saying("agrees")) + len(found.saying("disagrees"))
    assert 2 * norm.sf(found.limit) * (judged + 1) == pytest.approx(FALSE_ALARM)


def given(entry: object) -> dict[str, float]:
    config: Any = SimpleNamespace(
        nominal=Nominal.model_validate({"tolerance": entry}), parameters={}, vocabulary=HOUSE
    )
    return {**nominal_table(config, {}).tolerance}


def test_tolerances_by_number_and_by_symbol() -> None:
    assert given(0.05) == dict.fromkeys(PARAMETERS, 0.05)
    found = given({"default": 0.05, "k_s": 0.1})
    assert found == {**dict.fromkeys(PARAMETERS, 0.05), "k_s": 0.1}
    assert given({"k_s": 0.1})["r_m"] == 0.0


@run_cases("wrong", [-0.1, 1.0, 5, "5 %", {"k_x": 0.1}, {"k_s": 2}])
def test_tolerances_that_are_none_are_refused(wrong: object) -> None:
    with pytest.raises(ValidationError):
        given(wrong)


def row(name: str, word: str) -> ParameterRow:
    empty = {field.name: 0.0 for field in dataclasses.fields(ParameterRow)}
    return ParameterRow(**{**empty, "name": name, "word": word})  # type: ignore[arg-type]


@run_cases("word", ["determined", "weak", "prior only"])
def test_both_tables_have_one_word_for_one_unknown(word: str) -> None:
    """k_s and j_1 only as a ratio, r_m by itself, and a noise level that has no verdict."""
    found = verdict(gaussian(TABLE, RNG))
    assert [q.says for q in found.parameters] == ["not determined", "not determined", "agrees"]
    rows = [row(name, word) for name in (*found.names, "sigma_w_1")]
    words = [one.word for one in reconciled(rows, found)]
    blind = "through others" if word == "determined" else word
    assert words == [blind, blind, "determined", word]


def test_what_is_too_weak_without_a_symmetry_is_called_weak() -> None:
    found = verdict(gaussian(TABLE, RNG))
    seen = [dataclasses.replace(q, blind=False) for q in found.parameters]
    found = dataclasses.replace(found, parameters=tuple(seen))
    assert [r.word for r in reconciled([row("k_s", "determined")], found)] == ["weak"]
