"""The verdict on Gaussian posteriors, whose tails, entropies and products are known exactly."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2, norm
from support.case_tables import run_cases
from support.linear_study import (
    J_1,
    K_S,
    LINEAR,
    PRIOR,
    PRIOR_SD,
    R_M,
    RATIO,
    TABLE,
    draws_of,
    gaussian,
    linear_study,
    verdict,
    words,
)

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
from bayesdrill.config.schema.config import IdentifySpec
from bayesdrill.report.sections.nominal import verdict_sentences
from bayesdrill.tasks.run_entries import verdict_data

N = 4000
U = (np.arange(N) + 0.5) / N
NORMAL = norm.ppf(U)
RNG = np.random.default_rng(7)
VALUES = np.array([*TABLE.values()])


@run_cases("z", [0.3, 1.0, 2.4, 4.0, 12.0])
def test_the_tension_of_a_normal_posterior_is_its_z(z: float) -> None:
    for side in (-z, z):
        assert tension(0.02 * (NORMAL + side), 0.0, 0.0) == pytest.approx(z, rel=0.02)


@run_cases("x", [0.02, 0.2, 3.0])
def test_the_tension_of_a_skewed_posterior_is_its_tail_probability(x: float) -> None:
    tail = math.exp(-x) if x > math.log(2) else -math.expm1(-x)
    assert tension(-np.log(1 - U) - x, 0.0, 0.0) == pytest.approx(norm.isf(tail), abs=0.03)


def test_tension_counts_from_the_nearest_value_within_tolerance() -> None:
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


def test_joint_tension_far_beyond_all_probabilities_is_a_number() -> None:
    draws = 1e-4 * RNG.standard_normal((N, 2)) + 0.5
    result = joint_tension(draws, np.eye(2), np.zeros((2, 2)))
    assert result == pytest.approx(math.sqrt(2) * 0.5 / 1e-4, rel=0.05)


def test_joint_tension_vanishes_within_tolerance_only_if_the_factors_can_explain_it() -> None:
    """A factor of two products cannot be too large in the one and too small in the other."""
    powers = np.array([[1.0, -1.0], [1.0, 1.0]])
    draws = 0.01 * RNG.standard_normal((N, 2)) + [0.04, 0.06]  # factors 5 % up and 1 % up
    assert joint_tension(draws, powers, np.array([[-0.1, 0.1], [-0.1, 0.1]])) < 0.1
    assert joint_tension(draws, powers, np.array([[-0.02, 0.02], [-0.02, 0.02]])) > 2.0


def test_bits_gained_are_the_difference_of_entropies() -> None:
    flat, normal = RNG.uniform(-1.0, 1.0, 100_000), RNG.normal(0.0, 1.0, 100_000)
    for sd in (0.03, 1e-4):
        nats = math.log(2.0) - 0.5 * math.log(2 * math.pi * math.e) - math.log(sd)
        gained = bits_gained(sd * RNG.standard_normal(N), flat)
        assert gained == pytest.approx(nats / math.log(2), abs=0.1)
    assert bits_gained(RNG.normal(0.0, 1.0, N), normal) < 0.05
    assert bits_gained(RNG.normal(0.0, 0.5, N), normal) == pytest.approx(0.459, abs=0.05)


@pytest.mark.slow
def test_a_nominal_rig_is_rarely_said_to_disagree() -> None:
    """In 1 % of records at most; the limit is passed by chance once in 3000 such tests."""
    rng = np.random.default_rng(11)
    wrong = sum(not verdict(gaussian(TABLE, rng, 1000)).agrees for _ in range(250))
    assert wrong <= 9  # binomial(250, 0.01)


def test_narrow_draws_along_a_symmetry_determine_nothing() -> None:
    """The corners of a prior may make them so."""
    common = 1.4 + 0.01 * RNG.standard_normal(N)
    draws = np.stack([common, common * (1 + 0.01 * RNG.standard_normal(N)), 1 + 0.02 * NORMAL], -1)
    result = words(verdict(draws * VALUES))
    assert result[K_S] == result[J_1] == "not determined"


def test_a_weighed_part_settles_what_a_symmetry_hides() -> None:
    """With j_1 known to 1 % beforehand, k_s follows from k_s/j_1; j_1 itself is not the record's."""
    widths, rng = np.array([PRIOR_SD, 0.01, PRIOR_SD]), np.random.default_rng(9)
    prior = np.exp(widths * rng.standard_normal((N, 3))) * VALUES
    j_1 = np.exp(0.01 * rng.standard_normal(N))
    k_s = 1.2 * j_1 * np.exp(0.01 * rng.standard_normal(N))
    draws = np.stack([k_s, j_1, 1 + 0.02 * rng.standard_normal(N)], -1) * VALUES
    result = words(judge(linear_study(widths), draws, prior, TABLE, {}, (), IdentifySpec()))
    assert (result[K_S], result[J_1]) == ("disagrees", "not determined")


def test_a_deviation_within_tolerance_agrees() -> None:
    draws = draws_of(4, r_m=1.1)
    assert words(verdict(draws))[R_M] == "disagrees"
    tolerant = verdict(draws, tolerance=0.2)
    assert tolerant.agrees
    (r_m,) = (q for q in tolerant.parameters if q.exponents == R_M)
    assert r_m.beyond < 0.01


@run_cases("ratio", [0.55, 0.6, 1.9, 2.1])
def test_the_ends_of_a_tolerance_change_places_below_the_line(ratio: float) -> None:
    """k_s within 20 %, j_1 within 40 %: k_s/j_1 from 0.8/1.4 to 1.2/0.6."""
    wide = np.exp(2.0 * np.log(PRIOR / VALUES)) * VALUES
    tolerance = {"k_s": 0.2, "j_1": 0.4}
    result = judge(LINEAR, draws_of(4, k_s=ratio), wide, TABLE, tolerance, (), IdentifySpec())
    (product,) = (q for q in result.products if q.exponents == RATIO)
    assert product.tolerance == pytest.approx((0.8 / 1.4 - 1.0, 1.2 / 0.6 - 1.0))
    within = 0.8 / 1.4 < ratio < 1.2 / 0.6
    assert product.says == ("agrees" if within else "disagrees")
    assert result.agrees == within


def test_a_parameter_pressed_against_its_prior_is_said_to_be() -> None:
    result = words(verdict(draws_of(5), pressed=("r_m", "k_s")))
    assert result[R_M] == result[K_S] == "pressed against the prior"
    assert result[RATIO] == "agrees"


@run_cases("exponent, ratio, agrees", [(0.0, "agrees", True), (3.0, "cannot judge", None)])
def test_a_value_cut_off_by_an_end_at_its_nominal_value_cannot_be_judged(
    exponent: float, ratio: str, agrees: bool | None
) -> None:
    """Nor what it dominates: here k_s/j_1 follows r_m with this exponent."""
    r_m, j_1 = np.abs(0.02 * NORMAL), 0.1 * RNG.standard_normal(N)
    k_s = j_1 + 0.01 * NORMAL[::-1] + exponent * r_m
    draws = np.exp(np.stack([k_s, j_1, r_m], -1)) * VALUES
    ends = {"r_m": TABLE["r_m"]}
    result = judge(LINEAR, draws, PRIOR, TABLE, {}, ("r_m",), IdentifySpec(), ends)
    assert (words(result)[R_M], words(result)[RATIO]) == ("cannot judge", ratio)
    assert result.joint is None
    text = verdict_sentences(result, "table")
    if agrees:
        assert "Cannot judge: r_m. The prior of r_m ends at 0.33; widen it." in text
        assert "It agrees with table" in text
    else:
        assert "none of the 2 independent products" in text
        assert "Cannot judge: " in text
    assert verdict_data(result, "table")["agrees"] is agrees


def test_false_alarms_are_shared_by_all_that_is_judged() -> None:
    result = verdict(draws_of(3))
    judged = len(result.saying("agrees")) + len(result.saying("disagrees"))
    assert 2 * norm.sf(result.limit) * (judged + 1) == pytest.approx(FALSE_ALARM)


@run_cases("word", ["determined", "weak", "prior only"])
def test_both_tables_have_one_word_for_one_unknown(word: str) -> None:
    """k_s and j_1 only as a ratio, r_m by itself, and a noise level that has no verdict."""
    result = verdict(draws_of(8))
    fields = {field.name: 0.0 for field in dataclasses.fields(ParameterRow)}

    def reconciled_words(of: Verdict, *names: str) -> list[str]:
        rows: Any = [ParameterRow(**fields | {"name": name, "word": word}) for name in names]
        return [row.word for row in reconciled(rows, of)]

    hidden = "through others" if word == "determined" else word
    assert reconciled_words(result, *result.names, "sigma_w_1") == [
        hidden,
        hidden,
        "determined",
        word,
    ]
    seen = tuple(dataclasses.replace(q, blind=False) for q in result.parameters)
    without_symmetry = dataclasses.replace(result, parameters=seen)
    weaker = "weak" if word == "determined" else word
    assert reconciled_words(without_symmetry, "k_s") == [weaker]


def test_a_value_that_a_stuck_walker_repeats_leaves_the_bits_gained_finite() -> None:
    random = np.random.default_rng(0)
    prior, logs = random.normal(size=20_000), random.normal(scale=0.125, size=4_000)
    repeated = np.concatenate([logs, np.full(2_000, logs[0])])
    assert 0 < bits_gained(repeated, prior) < 6
