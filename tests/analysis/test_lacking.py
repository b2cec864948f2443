"""What a rig lacks: named with its size where it is to blame, and not where it is not."""

from __future__ import annotations

import numpy as np
import pytest
from lacking import T, against_the_table, believed, best, record
from together import for_each
from torques import TORQUE, observed, of

import bayesdrill as bd
from bayesdrill.analysis.causes import Cause, Causes, Instead, causes, instead
from bayesdrill.analysis.edits import LACKS
from bayesdrill.inference import residual_checks
from bayesdrill.report.sections import fit_words, verdict_words
from bayesdrill.rig.models.linear import USUAL
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.tasks import run_entries

PROBLEM = bd.load("configs/example_rig.yaml").job.problem
PHYSICS = {"t_c1": 0.25, "v_d": 0.8, "c_1": 0.02, "c_s": 5e-3}
STEADY = np.full(len(T), 8.0)


def found(*, known: bool = True, **added: float) -> Causes:
    posterior = believed(record(added), known=known)
    theta = best(posterior)
    assert not residual_checks.like_noise(residual_checks.left(posterior.likelihood, theta))
    named = causes(posterior, theta)
    assert named is not None
    return named


FEW = (("t_c1", True),)
MANY = tuple((name, known) for name in PHYSICS for known in (True, False))
GROUPS = [
    pytest.param(FEW, id="quick"),
    pytest.param(tuple(one for one in MANY if one not in FEW), id="long", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("cases", GROUPS)
def test_physics_that_is_missing_is_named_with_its_size(
    cases: tuple[tuple[str, bool], ...],
) -> None:
    """Mutants killed: friction that is not tried; one explanation taken for it that leaves more."""

    def check(name: str, known: bool) -> None:
        truth = PHYSICS[name]
        named = found(known=known, **{name: truth})
        assert named.explains
        assert named.lacking == (name,)
        assert named.found[0].value == pytest.approx(truth, rel=0.08)
        assert named.share > 0.8
        said = fit_words.explained(named, PROBLEM)
        assert f"say `parameters: {{{name}: {{prior: uniform, low: 0, high: " in said

    for_each({str(case): case for case in cases}, check)


@pytest.mark.slow
def test_two_at_once_are_both_named() -> None:
    named = found(t_cm=0.03, t_c1=0.2)
    assert set(named.lacking) == {"t_cm", "t_c1"}
    sizes = {one.of: one.value for one in named.found}
    assert sizes["t_c1"] == pytest.approx(0.2, rel=0.1)


@pytest.mark.slow
def test_sensors_and_physics_together() -> None:
    """A late twist and a supply that is off, and rotor 1 rubs: each alone would not do."""
    posterior = believed(record({"t_c1": 0.25}, late=3, supply=-0.4))
    named = causes(posterior, best(posterior))
    assert named is not None
    kinds = {(one.kind, one.of): one.value for one in named.found}
    assert kinds["rig", "t_c1"] == pytest.approx(0.25, rel=0.1)
    assert kinds["lag", "alpha"] == pytest.approx(0.03, abs=0.002)
    assert kinds["input offset", "v"] == pytest.approx(-0.4, abs=0.1)
    assert named.rest < 1.2


@pytest.mark.slow
def test_what_sensors_explain_is_not_blamed_on_the_rig() -> None:
    """Mutant killed: friction wherever it is as good as anything."""
    posterior = believed(record({}, late=3))
    named = causes(posterior, best(posterior))
    assert named is not None
    assert [(one.kind, one.of) for one in named.found] == [("lag", "alpha")]
    assert named.lacking == ()
    assert named.other is None
    assert fit_words.lacking(named, USUAL) == ""


def test_where_both_would_do_both_are_said() -> None:
    """Friction at the motor that little is left of: an offset of the supply would do, too."""
    posterior = believed(record({"t_cm": 0.05}))
    named = causes(posterior, best(posterior))
    assert named is not None
    assert named.lacking == ()
    assert named.other is not None
    assert named.other.lacking == ("t_cm",)
    said = fit_words.explained(named, PROBLEM)
    assert "or, as well as by these, by\n  - dry friction at the motor of " in said
    data = run_entries.causes_data(named)
    assert data is not None
    assert data["or"]["by"][0]["of"] == "t_cm"
    assert fit_words.lacking(named, USUAL) == "dry friction at the motor (t_cm)"


@pytest.mark.slow
def test_a_rig_that_has_it_is_not_said_to_lack_it() -> None:
    added = {"t_c1": 0.25, "t_cm": 0.03}
    rig = MotorShaft(added=("t_cm", "t_c1"))
    posterior = believed(record(added), rig, **added)
    left = residual_checks.left(posterior.likelihood, best(posterior))
    assert residual_checks.like_noise(left)
    late = believed(record(added, late=3), rig, **added)
    named = causes(late, best(late))
    assert named is not None
    assert not {"t_cm", "t_c1"} & {one.of for one in named.found}
    assert (named.found[0].kind, named.found[0].of) == ("lag", "alpha")


# The table, before it is blamed.


SIZES = PHYSICS | {"t_cm": 0.05}
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
        alternative = instead(against_the_table(posterior), theta)
        assert alternative is not None
        assert alternative.parameter == name
        assert alternative.value == pytest.approx(share * truth, rel=0.05)
        (said,) = fit_words.instead(alternative, USUAL)
        assert fit_words.LACKED[next(role for role in LACKS if USUAL[role] == name)] in said

    for_each(
        {
            f"{name}, {'steady' if steady else 'to and fro'}": (name, steady)
            for name, both in names.items()
            for steady in both
        },
        check,
    )


def test_a_table_that_is_wrong_is_not_excused() -> None:
    def check(steady: bool) -> None:
        posterior = believed(record({"k_e": 0.065}, STEADY if steady else None))
        assert instead(against_the_table(posterior), best(posterior)) is None

    for_each({str(steady): (steady,) for steady in [False, True]}, check)


def test_a_table_that_fits_needs_no_help_and_tolerances_count() -> None:
    posterior = believed(record({}))
    theta = best(posterior)
    assert instead(against_the_table(posterior), theta) is None
    # With a k_s that is 3 % off friction does not help, unless the table allows for it.
    rubs = believed(record({"t_c1": 0.05}))
    off = {"k_s": 1.03 * 0.26}
    assert instead(against_the_table(rubs, **off), best(rubs)) is None
    within = instead(against_the_table(rubs, 0.05, **off), best(rubs))
    assert within is not None
    assert within.parameter == "t_c1"


def test_a_table_beyond_the_priors_is_no_table_of_this_rig() -> None:
    posterior = believed(record({"t_c1": 0.05}))
    assert instead(against_the_table(posterior, k_s=26.0), best(posterior)) is None


# In words.


def test_a_verdict_in_doubt_says_what_is_missing() -> None:
    from verdicts import TABLE, gaussian, verdict

    draws = gaussian(TABLE | {"r_m": 2 * TABLE["r_m"]}, np.random.default_rng(2))
    doubtful = verdict(draws, fits=False)
    text = verdict_words.verdict_sentences(doubtful, "t", lacking="dry friction at rotor 1 (t_c1)")
    assert "against the model: it may miss dry friction at rotor 1 (t_c1)" in text
    assert "may miss" not in verdict_words.verdict_sentences(doubtful, "t")


def test_what_is_still_left_is_said_and_shares_are_never_rounded_up() -> None:
    cause = Cause(kind="rig", of="t_cm", experiment="", value=0.0025, sd=1e-5)
    much = Causes(share=0.99996, rest=9.0, found=(cause,))
    said = fit_words.explained(much, PROBLEM)
    assert said.startswith(
        "fit: 99.9 % of what is left beyond noise would be explained (down to 3 "
    )
    assert "dry friction at the motor of 0.0025 N m" in said
    assert "high: 0.005}" in said
    all_of_it = Causes(share=1.0, rest=1.0, found=(cause,))
    assert "down to" not in fit_words.explained(all_of_it, PROBLEM)
    assert run_entries.instead_data(None) == {}
    assert list(fit_words.instead(None, USUAL)) == []
    data = run_entries.instead_data(Instead(parameter="t_cm", value=0.1, lost=-3.0))
    assert data["instead"]["log_likelihood"] == 3.0


def test_each_that_is_tried_has_words_and_is_offered() -> None:
    assert {*fit_words.LACKED} == {*LACKS}
    assert {USUAL[role] for role in LACKS} <= {*MotorShaft.offers}


def test_beside_a_torque_that_is_known_the_friction_is_found() -> None:
    """With a filter that was told the parameters without what is tried, a rest of 90 was left."""
    known = {**TORQUE, "size": 1e-3, "time": 0.1}
    rubs, target = observed(rubs={"t_c1": 0.15}), observed(missing_torque=known)
    truth = rubs.space.vector(rubs.space.start)
    one = rubs.likelihood.alone
    clean = one.signals(rubs.space.full(truth[None]))
    y = one.draw(clean, truth[None], np.random.default_rng(3))[0]
    target = of(target, target.likelihood.alone.with_record(y))
    result = causes(target, target.space.vector(target.space.start))
    assert result is not None
    assert result.lacking == ("t_c1",)
