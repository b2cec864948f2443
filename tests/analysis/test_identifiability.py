"""Symmetries, bounds and remedies: against algebra, repeated fits, and the rig's own response."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, ORDER
from support.small_problems import noisy_step, posterior, replace_only, vector

from bayesdrill.analysis.identifiability import information, structure
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.identifiability.profile import THRESHOLD, Fitter, Profile, profile
from bayesdrill.analysis.identifiability.structure import (
    find_structure,
    scaled_by_two,
    sparse_basis,
)
from bayesdrill.analysis.identifiability.study import IdentifiabilityStudy, study_of
from bayesdrill.basics.symbols import PARAMETERS
from bayesdrill.config.schema.config import Asked
from bayesdrill.inference.priors import Uniform
from bayesdrill.report.sections import identify_words as words
from bayesdrill.rig.models.motor_shaft import MotorShaft, TwoRotors
from bayesdrill.rig.simulators.linear import Response

SIGMA = np.array([0.02, 0.01, 0.05, 0.03])  # unequal


def studied(record=None, sigma=SIGMA, **options) -> IdentifiabilityStudy:
    record = noisy_step(SIGMA) if record is None else record
    target = posterior(record, sigma, **options)
    theta = target.space.vector(target.space.start)
    return study_of(SensitivityStudy(target.likelihood), target, theta, Asked(), seek_remedies=True)


@pytest.fixture(scope="module")
def bundled() -> IdentifiabilityStudy:
    return studied()


def without(*names: str) -> tuple[str, ...]:
    return tuple(name for name in ORDER if name not in names)


def exponents(**powers: int) -> tuple[int, ...]:
    return tuple(powers.get(name, 0) for name in ORDER)


ELECTRICAL = exponents(k_T=1, r_m=1, l_m=1)
MECHANICAL = exponents(j_m=1, c_m=1, k_s=1, j_1=1, t_f=1, k_T=1)


def test_exactly_the_two_symmetries_and_seven_invariants(bundled: IdentifiabilityStudy) -> None:
    assert set(bundled.structure.symmetries) == {ELECTRICAL, MECHANICAL}
    assert bundled.structure.unexplained == 0
    invariants = np.array(bundled.structure.invariants)
    assert invariants.shape == (7, 9)
    assert np.linalg.matrix_rank(invariants) == 7
    assert not np.any(invariants @ np.array([ELECTRICAL, MECHANICAL]).T)


def test_the_symmetries_in_words(bundled: IdentifiabilityStudy) -> None:
    text = words.full(bundled, MotorShaft())
    assert (
        "j_m, c_m, k_T, k_s, j_1 and t_f can all be multiplied by the same factor without changing "
        "any measured signal"
    ) in text
    assert "k_T, r_m and l_m can all be multiplied by the same factor" in text


@run_cases(
    "held, left",
    [
        (("j_1",), 1),
        (("r_m",), 1),
        (("j_1", "r_m"), 0),
        (("k_e",), 2),
        (("j_m", "k_T", "r_m", "l_m", "k_s", "j_1", "t_f"), 0),
    ],
)
def test_what_is_held_breaks_symmetries(held: tuple[str, ...], left: int) -> None:
    found = studied(free=without(*held)).structure
    assert (len(found.symmetries), found.unexplained) == (left, 0)


def test_measuring_the_current_leaves_one() -> None:
    from support.small_problems import experiment

    target = posterior(experiment(101, 0.03, y=np.ones((101, 5))), np.full(5, 0.1))
    theta = vector(NOMINAL)
    found = study_of(SensitivityStudy(target.likelihood), target, theta, Asked())
    assert found.structure.symmetries == (MECHANICAL,)


def test_a_known_load_settles_the_mechanical_scale() -> None:
    from support.small_problems import experiment

    four = {name: {name: 1.0} for name in ("theta_1", "theta_2", "w_1", "w_2")}
    loaded = experiment(101, 0.03, measures=four, constant={"v": 8.0, "t_1": 0.05})
    assert studied(loaded).structure.symmetries == (ELECTRICAL,)


def test_noise_levels_that_are_unknown_take_no_part() -> None:
    assert set(studied(sigma=None).structure.symmetries) == {ELECTRICAL, MECHANICAL}


def test_a_direction_that_is_no_symmetry_is_not_claimed() -> None:
    """Mutant killed: candidates believed without being proven."""
    slopes = np.array([[1.0, -1.0, 0.0], [0.0, 0.0, 1.0]])  # null at these points: (1, 1, 0)
    found = find_structure(("a", "b", "c"), [slopes], lambda _: False)
    assert found.symmetries == ()
    assert found.unexplained == 1
    assert find_structure(("a", "b", "c"), [slopes], lambda _: True).symmetries == ((1, 1, 0),)


def test_only_what_is_null_everywhere_counts() -> None:
    """A sum a + b has a null direction at each point, but no common one."""
    points = [np.array([[a / (a + b), b / (a + b)]]) for a, b in ((1.0, 2.0), (3.0, 1.0))]
    assert len(structure.null_space(points)) == 0
    assert len(structure.null_space(points[:1])) == 1


def test_what_is_hardly_seen_is_no_symmetry() -> None:
    """One direction hardly shows at each point, and another at each; together they all show."""
    rng = np.random.default_rng(6)
    points = []
    for _ in range(3):
        turned = np.linalg.qr(rng.standard_normal((4, 4)))[0]
        points.append(rng.standard_normal((50, 4)) @ np.diag([1.0, 0.5, 0.3, 1e-9]) @ turned)
    made = structure.find_structure(tuple("abcd"), points, lambda _: False)
    assert made.unexplained == 0
    assert len(made.invariants) == 4
    # Next to nothing at all points alike, and proven: rounding of what changes nothing.
    alike = [rng.standard_normal((50, 4)) @ np.diag([1.0, 0.5, 0.3, 1e-9]) for _ in range(3)]
    made = structure.find_structure(tuple("abcd"), alike, lambda _: True)
    assert made.symmetries == ((0, 0, 0, 1),)
    assert made.unexplained == 0


def test_a_direction_that_turns_from_place_to_place_is_still_blind() -> None:
    """Of c and a + b: c shows, and the sum, but no product with a or b.  Mutant killed: only
    directions that are the same everywhere count."""
    points = [
        np.array([[a / (a + b), b / (a + b), 0.0], [0.0, 0.0, 1.0]])
        for a, b in ((1.0, 2.0), (3.0, 1.0), (0.4, 0.7))
    ]
    found = find_structure(("a", "b", "c"), points, lambda _: True)
    assert found.symmetries == ()
    assert found.unexplained == 1
    assert found.invariants == ((0, 0, 1),)


def test_a_known_inertia_beside_the_motors_settles_no_scale() -> None:
    """It only makes the two symmetries bend."""
    target = posterior(noisy_step(SIGMA), SIGMA)
    likelihood = target.likelihood
    rig = TwoRotors(j_2=7e-3, r_s=0.2)
    response = Response(rig, likelihood.only_observation.response.experiment)
    target = replace(target, likelihood=replace_only(likelihood, response=response))
    theta = target.space.vector(target.space.start)
    found = study_of(SensitivityStudy(target.likelihood), target, theta, Asked())
    assert found.structure.symmetries == ()
    assert found.structure.unexplained == 2
    shown = np.array(found.structure.invariants, dtype=float)
    assert np.linalg.matrix_rank(shown) == len(shown) == 5
    assert np.linalg.matrix_rank(np.vstack([shown, exponents(k_s=1, j_1=-1)])) == 5
    assert not shown[:, [ORDER.index("j_m"), ORDER.index("r_m")]].any()
    said = words.brief(found)
    assert "2 changes of several of j_m, c_m" in said
    assert "leave every signal as it is" in said


def test_where_no_symmetry_hides_anything_the_badly_known_are_named_with_their_bounds() -> None:
    found = studied(free=without("r_m", "j_1"))
    said = words.brief(found)
    known = dict(zip(found.names, found.parameters, strict=True))
    loose = [name for name, one in known.items() if one.bound > 0.5]
    assert 0 < len(loose) < len(known)
    first, second, *_ = said.split("; ")
    assert first == "no symmetry hides an unknown from this record"
    for name, one in known.items():
        assert (f"{name} to {words.percent(one.bound)}" in second) == (name in loose)


def test_where_all_is_known_it_is_said_in_short() -> None:
    assert words.brief(studied(free=("k_s", "k_e"))) == "the record determines every unknown"


def test_sparse_basis_finds_small_whole_exponents_under_any_mixing() -> None:
    true = np.array([[0, 0, 2, 1, -1, 0], [1, 1, 0, 0, 0, 3]])
    mixed = np.array([[0.3, -1.7], [2.2, 0.9]]) @ true
    assert set(sparse_basis(mixed)) == {(0, 0, 2, 1, -1, 0), (1, 1, 0, 0, 0, 3)}


def test_doubling_rounds_nothing() -> None:
    theta = np.array([[0.1, 0.3, 1e-7]])
    twice = scaled_by_two(theta, (1, -2, 0))
    assert np.array_equal(scaled_by_two(twice, (-1, 2, 0)), theta)


def test_sensitivities_are_the_slopes_of_the_response() -> None:
    """Mutant killed: a Dual's quotient rule; against Richardson differences of the response."""
    target = posterior(noisy_step(SIGMA), SIGMA)
    theta = vector(NOMINAL) * np.linspace(0.8, 1.2, 9)
    scenery = SensitivityStudy(target.likelihood)
    exact = scenery.sensitivities(theta).reshape(-1, 4, 9)

    def slopes(h: float) -> np.ndarray:
        shifts = np.exp(h * np.eye(9))
        signals = target.likelihood.signals(np.concatenate([theta * shifts, theta / shifts]))
        return (signals[:9] - signals[9:]) / (2 * h)

    numeric = (4 * slopes(1e-3) - slopes(2e-3)) / 3
    close = np.moveaxis(numeric, 0, -1) / SIGMA[:, None]
    assert np.abs(exact - close).max() < 1e-7 * np.abs(exact).max()


def test_a_point_that_was_left_is_forgotten() -> None:
    """Whatever is asked in between.  Mutants killed: the course that is kept is any point's, or any
    inputs'."""
    target = posterior(noisy_step(SIGMA), SIGMA)
    near, far = vector(NOMINAL), vector(NOMINAL) * np.linspace(0.8, 1.2, 9)
    pushed = information.DesignVariant(times={"v": 0.5})
    asked = [(near, pushed), (near, information.AS_RECORDED), (near, pushed), (far, pushed)]
    asked += [(far, information.AS_RECORDED), (near, information.AS_RECORDED)]
    scenery = SensitivityStudy(target.likelihood)
    for theta, scene in asked:
        fresh = SensitivityStudy(target.likelihood).with_nuisances(theta, scene)
        assert np.array_equal(scenery.with_nuisances(theta, scene), fresh)
    assert not np.array_equal(scenery.with_nuisances(near), scenery.with_nuisances(far))


def test_bounds_of_products_by_algebra() -> None:
    root = information.root_of(
        np.diag([10.0, 2.0, 0.0]) @ np.array([[1, -1, 0], [0, 1, 0], [0, 0, 1]])
    )
    known = information.Information(("a", "b", "c"), root)
    assert known.n_blind == 1
    assert known.bound(np.array([1.0, -1.0, 0.0])) == pytest.approx(0.1)
    assert known.bound(np.array([0.0, 1.0, 0.0])) == pytest.approx(0.5)
    assert known.bound(np.array([1.0, 0.0, 0.0])) == pytest.approx(np.hypot(0.1, 0.5))
    assert known.bound(np.array([1.0, 0.0, 1.0])) == np.inf
    joint = known.with_priors(np.array([np.inf, np.inf, 0.25]))
    assert joint.bound(np.array([1.0, 0.0, 1.0])) == pytest.approx(np.sqrt(0.01 + 0.25 + 0.25**2))


def test_simple_products_name_what_is_known() -> None:
    """k_s/j_1 first: the rotor's frequency; mutant killed: the price of a factor left out."""
    found = studied().products
    assert words.product(ORDER, found[0].exponents) == "k_s/j_1"
    assert found[0].sd < 1e-3
    assert [k.word for k in found].count("determined") == 5
    assert np.linalg.matrix_rank(np.array([k.exponents for k in found])) == 9


def test_a_parameter_without_a_trace_has_no_bound(bundled: IdentifiabilityStudy) -> None:
    bounds = dict(zip(bundled.names, (k.bound for k in bundled.parameters), strict=True))
    assert [name for name, bound in bounds.items() if np.isfinite(bound)] == ["k_e"]


def test_remedies_say_what_they_break(bundled: IdentifiabilityStudy) -> None:
    found = {r.what.split(" (")[0]: r for r in bundled.remedies}
    electrical = bundled.structure.symmetries.index(ELECTRICAL)
    mechanical = bundled.structure.symmetries.index(MECHANICAL)
    assert found["measure i"].breaks == (electrical,)
    assert found["measure i"].left == 1
    assert found["weigh or measure j_1 to 1 %"].breaks == (mechanical,)
    assert found["tie k_T = k_e"].left == 1
    load = next(r for what, r in found.items() if what.startswith("apply a known load"))
    assert load.breaks == (mechanical,)
    for what, remedy in found.items():
        if "voltage" in what or "coast" in what or "k_e to" in what:
            assert (remedy.breaks, remedy.left) == ((), 2)
        assert remedy.shrink > 0.999  # nothing that is learnt makes anything less known


def test_profile_of_a_gaussian_problem_is_a_parabola() -> None:
    """Two well-known unknowns: the 95 % interval is best +- 1.96 sd, the loss quadratic."""
    small = np.full(4, 1e-3)
    target = posterior(noisy_step(small), small, free=("k_s", "j_m"))
    theta = target.space.vector(target.space.start)
    fitter = Fitter(target, SensitivityStudy(target.likelihood), theta)
    found = profile(fitter, ("k_s", "j_m"), 0)
    sd = fitter.spread()[0]
    assert found.shape == "bounded"
    assert np.log(found.high / found.low) == pytest.approx(
        2 * np.sqrt(2 * THRESHOLD) * sd, rel=0.01
    )
    away = np.log(found.values / found.best) / sd
    near = np.abs(away) < 3.5
    assert np.allclose(found.loss[near], 0.5 * away[near] ** 2, atol=0.05)


def test_profile_of_what_the_record_does_not_show_is_flat() -> None:
    target = posterior(noisy_step(SIGMA), SIGMA, free=without("j_1"))
    theta = target.space.vector(target.space.start)
    fitter = Fitter(target, SensitivityStudy(target.likelihood), theta)
    names = without("j_1")
    flat = profile(fitter, names, names.index("l_m"))
    assert flat.shape == "flat"
    assert flat.loss.max() < THRESHOLD
    assert profile(fitter, names, names.index("k_s")).shape == "bounded"


def test_a_profile_whose_best_fit_is_an_end_of_its_prior_has_each_place_once() -> None:
    """Mutant killed: places between the best fit and an end where it is already."""
    high = 0.9 * NOMINAL["k_s"]  # below what fits
    priors = {"k_s": Uniform(0.5 * high, high)}
    target = posterior(noisy_step(SIGMA), SIGMA, free=("k_s", "j_m"), priors=priors)
    theta = target.space.vector({"k_s": high, "j_m": NOMINAL["j_m"]})
    found = profile(Fitter(target, SensitivityStudy(target.likelihood), theta), ("k_s", "j_m"), 0)
    assert found.best == pytest.approx(high)
    assert np.diff(found.values).min() > 1e-6 * high


def test_a_profile_through_the_priors_of_others_is_no_limit_of_the_record() -> None:
    """Mutant killed: the record bounds what no such record can show."""
    names = ("k_T", "r_m", "l_m", "k_e")  # the first three with one factor leave every signal
    line = np.linspace(1.0, 2.0, 5)
    found = [
        Profile(name=name, values=line, loss=line, best=1.5, low=low, high=1.8, shape=shape)
        for name, low, shape in (("r_m", None, "one-sided"), ("k_e", 1.2, "bounded"))
    ]
    _, _, open_one, tied = words.profiles(
        found, studied(free=names), [PARAMETERS[name] for name in names]
    ).splitlines()
    assert open_one.endswith(f"one-sided: {words.THROUGH_OTHERS}")
    assert tied.endswith(f"bounded: {words.SHAPES['bounded']}")


def test_the_tie_of_an_ideal_motor_leaves_one() -> None:
    from pathlib import Path

    from bayesdrill.analysis.identifiability.study import study_of
    from bayesdrill.config import job, loading

    source = loading.load(Path(__file__).parents[2] / "configs" / "nominal_step.yaml").source
    source.data["parameters"]["k_T"] = {"tie": "k_e"}
    tied = job.assemble(loading.validate(source))
    target = tied.problem.posterior
    theta = target.space.vector(target.space.start)
    found = study_of(SensitivityStudy(target.likelihood), target, theta, tied.asked).structure
    assert len(found.symmetries) == 1
    # k_T stays, so the factor of the mechanical scale is undone by the electrical one.
    powers = dict(zip(found.names, found.symmetries[0], strict=True))
    assert powers["j_m"] == -powers["r_m"] != 0
