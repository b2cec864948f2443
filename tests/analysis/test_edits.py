"""Physics that a rig may lack: what is tried, and tables that are right once a rig has it."""

from functools import cache
from itertools import product

import numpy as np
import pytest
from support.case_tables import slow_except
from support.missing_physics import T, against_the_table, believed, best, record

from bayesdrill.analysis.causes import equivalent_explanation
from bayesdrill.analysis.edits import lacks
from bayesdrill.inference.posterior import Posterior
from bayesdrill.report.sections.causes import instead
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.models.roles import usual_roles

STEADY = np.full(len(T), 8.0)
SIZES = {"t_c1": 0.05, "v_d": 0.16, "c_1": 4e-3, "c_s": 1e-3, "t_cm": 0.05}


@cache
def fit_of(steady: bool = False, **added: float) -> tuple[Posterior, np.ndarray]:
    """Return a posterior without the `added` parameters, and its maximum."""
    target = believed(record(added, STEADY if steady else None))
    return target, best(target)


EVERY = slow_except((("t_c1", False),), product(SIZES, (False, True)))


@pytest.mark.parametrize("case", EVERY)
def test_a_table_is_right_with_the_physics_that_the_rig_lacks(case: tuple[str, bool]) -> None:
    name, steady = case
    target, theta = fit_of(steady, **{name: SIZES[name]})
    explanation = equivalent_explanation(against_the_table(target), theta)
    assert explanation.parameter == name
    assert explanation.value == pytest.approx(SIZES[name], rel=0.05)
    (text,) = instead(explanation, MotorShaft())
    assert next(x.description for x in lacks(usual_roles()) if x.parameter == name) in text


@pytest.mark.parametrize("steady", slow_except((False,), (False, True)))
def test_a_wrong_table_is_not_excused(steady: bool) -> None:
    target, theta = fit_of(steady, k_e=0.065)
    assert equivalent_explanation(against_the_table(target), theta) is None


def test_a_table_that_fits_or_is_beyond_the_priors_is_not_explained() -> None:
    target, theta = fit_of()
    assert equivalent_explanation(against_the_table(target), theta) is None
    assert list(instead(None, MotorShaft())) == []
    target, theta = fit_of(t_c1=0.05)
    assert equivalent_explanation(against_the_table(target, k_s=26.0), theta) is None


@pytest.mark.slow
def test_friction_helps_no_table_that_is_off_unless_its_tolerance_allows_for_it() -> None:
    target, theta = fit_of(t_c1=0.05)
    off = {"k_s": 1.03 * 0.26}
    assert equivalent_explanation(against_the_table(target, **off), theta) is None
    within = equivalent_explanation(against_the_table(target, 0.05, **off), theta)
    assert within.parameter == "t_c1"


def test_everything_that_is_tried_has_words_and_is_offered_by_the_rig() -> None:
    tried = lacks(usual_roles())
    assert {x.parameter for x in tried} - {*MotorShaft.parameters} <= {*MotorShaft.offers}
    assert all(x.description and x.name for x in tried)
