"""A table that may be right after all, of a rig that lacks something."""

from __future__ import annotations

import numpy as np
import pytest
from support.case_tables import for_each, run_cases
from support.missing_physics import T, against_the_table, believed, best, record

from bayesdrill.analysis.causes import equivalent_explanation
from bayesdrill.analysis.edits import lacks, with_candidates
from bayesdrill.report.sections import causes_words, verdict_words
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.models.roles import usual_roles
from benchmarks.rates.records import TORQUE, observed

STEADY = np.full(len(T), 8.0)
SIZES = {"t_c1": 0.25, "v_d": 0.8, "c_1": 0.02, "c_s": 5e-3, "t_cm": 0.05}
TABLES = [
    pytest.param({n: (False, True) if n == "t_c1" else (False,) for n in SIZES}, id="quick"),
    pytest.param({n: (True,) for n in SIZES if n != "t_c1"}, id="long", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("names", TABLES)
def test_a_table_is_right_with_what_is_missing(names: dict[str, tuple[bool, ...]]) -> None:
    """Mutants killed: all that is tried left free, a table that is not held."""

    def check(name: str, steady: bool) -> None:
        share = 1.0 if name == "t_cm" else 0.2
        truth = SIZES[name]
        posterior = believed(record({name: share * truth}, STEADY if steady else None))
        theta = best(posterior)
        alternative = equivalent_explanation(against_the_table(posterior), theta)
        assert alternative is not None
        assert alternative.parameter == name
        assert alternative.value == pytest.approx(share * truth, rel=0.05)
        (said,) = causes_words.instead(alternative, MotorShaft())
        assert next(x.words for x in lacks(usual_roles()) if x.parameter == name) in said

    for_each(
        {
            f"{name}, {'steady' if steady else 'to and fro'}": (name, steady)
            for name, both in names.items()
            for steady in both
        },
        check,
    )


@run_cases("steady", [False, True])
def test_a_table_that_is_wrong_is_not_excused(steady: bool) -> None:
    posterior = believed(record({"k_e": 0.065}, STEADY if steady else None))
    assert equivalent_explanation(against_the_table(posterior), best(posterior)) is None


def test_a_table_that_fits_needs_no_help_and_tolerances_count() -> None:
    posterior = believed(record({}))
    theta = best(posterior)
    assert equivalent_explanation(against_the_table(posterior), theta) is None
    # With a k_s that is 3 % off friction does not help, unless the table allows for it.
    rubs = believed(record({"t_c1": 0.05}))
    off = {"k_s": 1.03 * 0.26}
    assert equivalent_explanation(against_the_table(rubs, **off), best(rubs)) is None
    within = equivalent_explanation(against_the_table(rubs, 0.05, **off), best(rubs))
    assert within is not None
    assert within.parameter == "t_c1"


def test_a_table_beyond_the_priors_is_no_table_of_this_rig() -> None:
    posterior = believed(record({"t_c1": 0.05}))
    assert equivalent_explanation(against_the_table(posterior, k_s=26.0), best(posterior)) is None


def test_a_verdict_in_doubt_says_what_is_missing() -> None:
    from support.linear_study import TABLE, gaussian, verdict

    draws = gaussian(TABLE | {"r_m": 2 * TABLE["r_m"]}, np.random.default_rng(2))
    doubtful = verdict(draws, fits=False)
    text = verdict_words.verdict_sentences(doubtful, "t", lacking="dry friction at rotor 1 (t_c1)")
    assert "against the model. It may lack dry friction at rotor 1 (t_c1)" in text
    assert "may miss" not in verdict_words.verdict_sentences(doubtful, "t")


def test_where_a_table_needs_no_help_nothing_is_said() -> None:
    assert list(causes_words.instead(None, MotorShaft())) == []


def test_each_that_is_tried_has_words_and_is_offered() -> None:
    tried = lacks(usual_roles())
    assert {x.parameter for x in tried} - {*MotorShaft.parameters} <= {*MotorShaft.offers}
    assert all(x.words and x.name for x in tried)


def test_what_is_tried_is_what_a_config_would_switch_on() -> None:
    """Beside a missing torque, whose filter has to be told of it; at zero nothing is changed.

    Mutant killed: a filter of the parameters without what is tried.
    """
    known = {**TORQUE, "size": 1e-3, "time": 0.1}
    without = observed(missing_torque=known)
    rubs = observed(missing_torque=known, rubs={"t_c1": 0.15})
    theta = without.space.vector(without.space.start)
    wide = with_candidates(without, theta)
    free = wide.space.free
    new = [k for k, name in enumerate(free) if name not in without.space.free]
    at = np.insert(theta, new[0], np.zeros(len(new)))
    assert wide.likelihood(at[None]) == pytest.approx(without.likelihood(theta[None]))
    at[free.index("t_c1")] = 0.15
    assert wide.likelihood(at[None]) == pytest.approx(rubs.likelihood(theta[None]), rel=1e-6)
