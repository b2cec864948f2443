"""What a record of the nominal rig can show: symmetries, products, bounds, remedies, and their words."""

from functools import cache

import numpy as np
from support.scipy_oracles import ORDER
from support.small_problems import noisy_step, posterior

from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.identifiability.profile import Profile
from bayesdrill.analysis.identifiability.study import IdentifiabilityStudy, study_of
from bayesdrill.basics.symbols import PARAMETERS
from bayesdrill.config.schema.config import IdentifySpec
from bayesdrill.inference.posterior import Posterior
from bayesdrill.report.sections.identifiability import (
    SHAPES,
    THROUGH_OTHERS,
    describe_profiles,
    describe_study,
    product,
)
from bayesdrill.rig.models.motor_shaft import MotorShaft

SIGMA = np.array([0.02, 0.01, 0.05, 0.03])  # unequal
RECORD = noisy_step(SIGMA)


def study(
    target: Posterior, settings: IdentifySpec | None = None, seed: int = 0
) -> IdentifiabilityStudy:
    """Return that at the start values."""
    theta = target.space.vector(target.space.start)
    sensitivity = SensitivityStudy(target.likelihood)
    settings = settings or IdentifySpec()
    return study_of(sensitivity, target, theta, settings, seed, seek_remedies=True)


@cache
def study_with(*free: str) -> IdentifiabilityStudy:
    return study(posterior(RECORD, SIGMA, free=free))


def without(*names: str) -> tuple[str, ...]:
    return tuple(name for name in ORDER if name not in names)


def exponents(**powers: int) -> tuple[int, ...]:
    return tuple(powers.get(name, 0) for name in ORDER)


ELECTRICAL = exponents(k_T=1, r_m=1, l_m=1)
MECHANICAL = exponents(j_m=1, c_m=1, k_s=1, j_1=1, t_f=1, k_T=1)


def test_the_rig_has_two_symmetries_and_seven_invariants() -> None:
    nominal = study_with(*ORDER)
    assert set(nominal.structure.symmetries) == {ELECTRICAL, MECHANICAL}
    assert nominal.structure.unexplained == 0
    invariants = np.array(nominal.structure.invariants)
    assert invariants.shape == (7, 9)
    assert np.linalg.matrix_rank(invariants) == 7
    assert not np.any(invariants @ np.array([ELECTRICAL, MECHANICAL]).T)
    text = describe_study(nominal, MotorShaft())
    assert (
        "j_m, c_m, k_T, k_s, j_1 and t_f can all be multiplied by the same factor without changing "
        "any measured signal"
    ) in text
    assert "k_T, r_m and l_m can all be multiplied by the same factor" in text


def test_the_best_known_product_is_the_frequency_of_the_rotor() -> None:
    result = study_with(*ORDER).products
    assert product(ORDER, result[0].exponents) == "k_s/j_1"
    assert result[0].sd < 1e-3
    assert [product.word for product in result].count("determined") == 5
    assert np.linalg.matrix_rank(np.array([product.exponents for product in result])) == 9


def test_a_parameter_that_a_symmetry_hides_has_no_bound() -> None:
    result = study_with(*ORDER)
    bounds = dict(zip(result.names, (k.bound for k in result.parameters), strict=True))
    assert [name for name, bound in bounds.items() if np.isfinite(bound)] == ["k_e"]


def test_remedies_say_which_symmetry_they_break() -> None:
    result = study_with(*ORDER)
    remedies = {remedy.what.split(" (")[0]: remedy for remedy in result.remedies}
    electrical, mechanical = map(result.structure.symmetries.index, (ELECTRICAL, MECHANICAL))
    assert remedies["measure i"].breaks == (electrical,)
    assert remedies["measure i"].left == 1
    assert remedies["weigh or measure j_1 to 1 %"].breaks == (mechanical,)
    assert remedies["tie k_T = k_e"].left == 1
    load = next(r for what, r in remedies.items() if what.startswith("apply a known load"))
    assert load.breaks == (mechanical,)
    added = next(r for r in result.remedies if r.what.endswith("added to j_1"))
    assert added.breaks == (mechanical,)
    # The frequencies without and with it determine j_1 as well as the added part is weighed.
    weighed = remedies["weigh or measure j_1 to 1 %"]
    assert abs(added.shrink / weighed.shrink - 1.0) < 0.02
    for what, remedy in remedies.items():
        if "voltage" in what or "coast" in what or "k_e to" in what:
            assert (remedy.breaks, remedy.left) == ((), 2)
        assert remedy.shrink > 0.999  # what is learnt makes nothing less known


def test_a_profile_that_the_priors_of_others_bound_is_no_limit_of_the_record() -> None:
    names = ("k_T", "r_m", "l_m", "k_e")  # the first three with one factor leave every signal
    line = np.linspace(1.0, 2.0, 5)
    profiles = [
        Profile(name=name, values=line, loss=line, best=1.5, low=low, high=1.8, shape=shape)
        for name, low, shape in (("r_m", None, "one-sided"), ("k_e", 1.2, "bounded"))
    ]
    symbols = [PARAMETERS[name] for name in names]
    _, _, r_m, k_e = describe_profiles(profiles, study_with(*names), symbols).splitlines()
    assert r_m.endswith(f"one-sided: {THROUGH_OTHERS}")
    assert k_e.endswith(f"bounded: {SHAPES['bounded']}")
