"""Symmetries that are proven, directions without any, and scales that held numbers settle."""

import numpy as np
import pytest
from support.case_tables import run_cases
from support.scipy_oracles import ORDER
from support.small_problems import noisy_step, posterior

from bayesdrill.analysis.identifiability.information import (
    Information,
    SensitivityStudy,
    from_sensitivities,
    root_of,
)
from bayesdrill.analysis.identifiability.structure import (
    DependsOnFixed,
    depends_on_fixed,
    find_structure,
    null_space,
    prior_following,
    scaled_by_two,
    sparse_basis,
)
from bayesdrill.analysis.identifiability.study import prior_spreads, study_of
from bayesdrill.config.schema.config import IdentifySpec
from bayesdrill.inference.posterior import Posterior
from bayesdrill.report.sections.identifiability import dependence_sentences

# Slopes by a, b, c at some points, where the record shows a + b and c.
SUMS = [
    np.array([[a / (a + b), b / (a + b), 0.0], [0.0, 0.0, 1.0]])
    for a, b in ((1.0, 2.0), (3.0, 1.0), (0.4, 0.7))
]


def test_a_direction_counts_as_a_symmetry_only_if_it_is_proven() -> None:
    slopes = np.array([[1.0, -1.0, 0.0], [0.0, 0.0, 1.0]])  # null at these points: (1, 1, 0)
    unproven = find_structure(("a", "b", "c"), [slopes], lambda _: False)
    assert (unproven.symmetries, unproven.unexplained) == ((), 1)
    assert find_structure(("a", "b", "c"), [slopes], lambda _: True).symmetries == ((1, 1, 0),)


def test_a_null_direction_that_turns_from_point_to_point_is_unexplained() -> None:
    assert len(null_space(SUMS[:1])) == 1
    assert len(null_space(SUMS)) == 0
    result = find_structure(("a", "b", "c"), SUMS, lambda _: True)
    assert (result.symmetries, result.unexplained) == ((), 1)
    assert result.invariants == ((0, 0, 1),)


def test_a_direction_that_is_hardly_seen_is_no_symmetry_unless_it_is_everywhere() -> None:
    rng, small = np.random.default_rng(6), np.diag([1.0, 0.5, 0.3, 1e-9])
    turned = []
    for _ in range(3):
        rotation = np.linalg.qr(rng.standard_normal((4, 4)))[0]
        turned.append(rng.standard_normal((50, 4)) @ small @ rotation)
    result = find_structure(tuple("abcd"), turned, lambda _: False)
    assert result.unexplained == 0
    assert len(result.invariants) == 4
    alike = [rng.standard_normal((50, 4)) @ small for _ in range(3)]
    result = find_structure(tuple("abcd"), alike, lambda _: True)
    assert (result.symmetries, result.unexplained) == (((0, 0, 0, 1),), 0)


def test_a_sparse_basis_has_small_whole_exponents_under_any_mixing() -> None:
    true = np.array([[0, 0, 2, 1, -1, 0], [1, 1, 0, 0, 0, 3]])
    mixed = np.array([[0.3, -1.7], [2.2, 0.9]]) @ true
    assert set(sparse_basis(mixed)) == {(0, 0, 2, 1, -1, 0), (1, 1, 0, 0, 0, 3)}


def test_scaling_by_powers_of_two_rounds_nothing() -> None:
    theta = np.array([[0.1, 0.3, 1e-7]])
    twice = scaled_by_two(theta, (1, -2, 0))
    assert np.array_equal(scaled_by_two(twice, (-1, 2, 0)), theta)


SIGMA = np.array([0.02, 0.01, 0.05, 0.03])
MECHANICAL = frozenset({"j_m", "c_m", "k_T", "k_s", "j_1", "t_f"})
ELECTRICAL = frozenset({"k_T", "r_m", "l_m"})
Scales = set[tuple[frozenset[str], frozenset[str]]]


def target_with(*held: str, sigma: np.ndarray | None = SIGMA) -> Posterior:
    free = tuple(name for name in ORDER if name not in held)
    return posterior(noisy_step(SIGMA), sigma, free=free)


def dependences(target: Posterior) -> tuple[DependsOnFixed, ...]:
    theta = target.space.vector(target.space.start)
    study = SensitivityStudy(target.likelihood)
    known = from_sensitivities(study.unknowns, study.sensitivities(theta))
    spreads = prior_spreads(target)[: len(study.unknowns)]
    return depends_on_fixed(target, theta, known, spreads, np.random.default_rng(1))


def scales(target: Posterior) -> Scales:
    """Return sets of unknowns, each with the held numbers that settle its scale."""
    return {(frozenset(one.unknown), frozenset(one.through)) for one in dependences(target)}


def scale(group: frozenset[str], held: str) -> tuple[frozenset[str], frozenset[str]]:
    return group - {held}, frozenset({held})


HELD: dict[str, tuple[Posterior, Scales]] = {
    "j_1": (target_with("j_1"), {scale(MECHANICAL, "j_1")}),
    "r_m": (target_with("r_m"), {scale(ELECTRICAL, "r_m")}),
    "j_1, noise unknown": (target_with("j_1", sigma=None), {scale(MECHANICAL, "j_1")}),
    "r_m, noise unknown": (target_with("r_m", sigma=None), {scale(ELECTRICAL, "r_m")}),
    "each scale by its own": (
        target_with("j_1", "l_m"), {scale(MECHANICAL, "j_1"), scale(ELECTRICAL, "l_m")}
    ),
    "none": (target_with(), set()),
    "k_e, which scales nothing": (target_with("k_e"), set()),
    "all that a scale has": (target_with(*MECHANICAL, *ELECTRICAL), set()),
}  # fmt: skip


@run_cases("target, expected", HELD.values(), HELD)
def test_a_held_number_settles_the_scale_of_its_symmetry(
    target: Posterior, expected: Scales
) -> None:
    assert scales(target) == expected


def test_one_unknown_beside_many_held_numbers_does_not_depend_on_them() -> None:
    target = target_with(*MECHANICAL - {"k_s"})
    assert all("k_s" not in one.unknown for one in dependences(target))


def test_a_held_number_that_the_record_hardly_shows_leaves_its_scale_to_priors() -> None:
    """k_e/(r_m k_s) is known well, r_m through a held l_m to `sd`; r_m and k_e have priors of 0.3."""
    names, priors = ("k_s", "r_m", "k_e"), np.array([3.0, 0.3, 0.3])
    ratio = np.array([1.0, 1.0, -1.0]) / 1e-3

    def dependence(sd: float) -> DependsOnFixed:
        known = Information(names, root_of(np.vstack([ratio, [0.0, 1.0 / sd, 0.0]])))
        following = prior_following(known, priors)
        exponents = (-1, 1, 0, 1)
        return DependsOnFixed(
            names=(*names, "l_m"), exponents=exponents, held=("l_m",), following=following
        )

    loose, tight = dependence(3.0), dependence(0.03)
    assert loose.priors(names, (1, 0, 0)) == ("r_m", "k_e")
    assert loose.priors(names, (0, 1, 0)) == ("r_m",)
    assert tight.priors(names, (1, 0, 0)) == tight.priors(names, (0, 1, 0)) == ()
    for sd in (3.0, 0.03):
        share = dependence(sd).following[0] @ [-1.0, 1.0, 0.0] / -1.0
        assert share == pytest.approx(0.3**-2 / (0.3**-2 + sd**-2), abs=0.01)


def test_a_record_too_noisy_for_the_inductance_depends_on_the_prior_of_the_resistance() -> None:
    sigma = 100.0 * SIGMA
    target = posterior(noisy_step(sigma), sigma, free=("j_m", "k_e", "k_T", "r_m"))
    theta = target.space.vector(target.space.start)
    known = SensitivityStudy(target.likelihood)
    text = dependence_sentences(study_of(known, target, theta, IdentifySpec(), 0))
    assert "depend on the prior" in text
    assert "more than on the record, which hardly shows l_m." in text
