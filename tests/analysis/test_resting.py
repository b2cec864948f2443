"""Scales that held numbers settle: against the rig's two symmetries, and a rig that is scaled.

Mutants killed: symmetries of held numbers alone, or of unknowns alone; a prior about another value.
"""

from __future__ import annotations

import dataclasses
import importlib
from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases
from support.linear_study import TABLE, gaussian, verdict
from support.scipy_oracles import ORDER
from support.small_problems import likelihood_of, noisy_step, posterior

from bayesdrill.analysis.identifiability.information import (
    Information,
    SensitivityStudy,
    from_sensitivities,
    root_of,
)
from bayesdrill.analysis.identifiability.structure import (
    DependsOnFixed,
    depends_on_fixed,
    prior_following,
)
from bayesdrill.analysis.identifiability.study import prior_spreads, study_of
from bayesdrill.config.schema.config import Asked
from bayesdrill.inference.posterior import Posterior
from bayesdrill.report.sections import identify_words, verdict_words
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.linear import Response

SIGMA = np.array([0.02, 0.01, 0.05, 0.03])
MECHANICAL = frozenset({"j_m", "c_m", "k_T", "k_s", "j_1", "t_f"})
ELECTRICAL = frozenset({"k_T", "r_m", "l_m"})


def found(*held: str, sigma: np.ndarray | None = SIGMA) -> tuple[DependsOnFixed, ...]:
    free = tuple(name for name in ORDER if name not in held)
    target = posterior(noisy_step(SIGMA), sigma, free=free)
    theta = target.space.vector(target.space.start)
    return rests(target, theta)


def rests(target: Posterior, theta: np.ndarray) -> tuple[DependsOnFixed, ...]:
    scenery = SensitivityStudy(target.likelihood)
    known = from_sensitivities(scenery.unknowns, scenery.sensitivities(theta))
    before = prior_spreads(target)[: len(scenery.unknowns)]
    return depends_on_fixed(target, theta, known, before, np.random.default_rng(1))


def sets(found: tuple[DependsOnFixed, ...]) -> set[tuple[frozenset[str], frozenset[str]]]:
    return {(frozenset(one.unknown), frozenset(one.through)) for one in found}


@run_cases("sigma, name", [(sigma, name) for sigma in [SIGMA, None] for name in ["j_1", "r_m"]])
def test_a_held_number_settles_its_scale(sigma: np.ndarray | None, name: str) -> None:
    """Of a noise that is known and of one that is not."""
    whole = MECHANICAL if name == "j_1" else ELECTRICAL
    assert sets(found(name, sigma=sigma)) == {(whole - {name}, frozenset({name}))}


def test_each_scale_rests_on_its_own() -> None:
    assert sets(found("j_1", "l_m")) == {
        (MECHANICAL - {"j_1"}, frozenset({"j_1"})),
        (ELECTRICAL - {"l_m"}, frozenset({"l_m"})),
    }


def test_numbers_that_scale_nothing_unknown_are_not_named() -> None:
    assert found() == ()
    assert found("k_e") == ()
    assert found(*MECHANICAL, *ELECTRICAL) == ()


def test_one_that_is_sought_among_many_that_are_held_is_not_warned_of() -> None:
    assert all("k_s" not in one.unknown for one in found(*MECHANICAL - {"k_s"}))


def test_what_rests_is_what_a_symmetry_changes() -> None:
    (one,) = found("l_m")
    assert one.scales(("r_m", "k_T"), (1, 0))
    assert one.scales(("k_s", "k_T"), (1, -1))
    assert not one.scales(("r_m", "k_T"), (1, -1))
    assert not one.scales(("k_s", "j_1"), (1, -1))


def test_what_the_record_hardly_shows_settles_nothing() -> None:
    """k_e/(r_m k_s) is known well, r_m through a held l_m to `sd`; r_m and k_e have priors of 0.3.

    Mutants killed: a scale that always rests on what is held; a prior that is named whatever it tells.
    """
    names, before = ("k_s", "r_m", "k_e"), np.array([3.0, 0.3, 0.3])
    ratio = np.array([1.0, 1.0, -1.0]) / 1e-3

    def rest(sd: float) -> DependsOnFixed:
        known = Information(names, root_of(np.vstack([ratio, [0.0, 1.0 / sd, 0.0]])))
        return DependsOnFixed(
            names=(*names, "l_m"),
            exponents=(-1, 1, 0, 1),
            held=("l_m",),
            following=prior_following(known, before),
        )

    loose, tight = rest(3.0), rest(0.03)
    assert loose.priors(names, (1, 0, 0)) == ("r_m", "k_e")
    assert loose.priors(names, (0, 1, 0)) == ("r_m",)
    assert tight.priors(names, (1, 0, 0)) == tight.priors(names, (0, 1, 0)) == ()
    shares = [rest(sd).following[0] @ [-1.0, 1.0, 0.0] / -1.0 for sd in (3.0, 0.03)]
    alone = [0.3**-2 / (0.3**-2 + sd**-2) for sd in (3.0, 0.03)]
    assert shares == pytest.approx(alone, abs=0.01)


def test_a_record_too_loud_for_the_inductance_rests_on_the_resistance_s_prior() -> None:
    sigma = 100.0 * SIGMA
    target = posterior(noisy_step(sigma), sigma, free=("j_m", "k_e", "k_T", "r_m"))
    theta = target.space.vector(target.space.start)
    made = study_of(SensitivityStudy(target.likelihood), target, theta, Asked())
    text = identify_words.dependence_sentences(made)
    assert "depend on the prior" in text
    assert "more than on the record, which hardly shows l_m." in text


def test_in_words_before_sampling_and_in_the_verdict() -> None:
    target = posterior(
        noisy_step(SIGMA), SIGMA, free=tuple(name for name in ORDER if name != "l_m")
    )
    theta = target.space.vector(target.space.start)
    made = study_of(SensitivityStudy(target.likelihood), target, theta, Asked())
    for text in (identify_words.full(made, MotorShaft()), identify_words.brief(made)):
        assert "k_T and r_m depend on l_m, which the config holds, and can be right only" in text
    judged = verdict(gaussian({**TABLE, "r_m": 1.2 * TABLE["r_m"]}, np.random.default_rng(2)))
    said = verdict_words.verdict_sentences(judged, "table", rests=made.resting)
    (line,) = (line for line in said.splitlines() if "depends on l_m" in line)
    assert line.startswith("r_m depends on l_m, which the config holds fixed")
    leaning = dataclasses.replace(made.resting[0], following=np.eye(len(made.names)))
    text = verdict_words.verdict_sentences(judged, "table", rests=(leaning,))
    assert "depends on the prior of r_m, as the record by itself tells little" in text
    elsewhere = dataclasses.replace(made.resting[0], names=("k_s", "j_1", "l_m", "r_m"))
    apart = dataclasses.replace(elsewhere, exponents=(1, 1, 1, 0))
    assert " depend" not in verdict_words.verdict_sentences(judged, "table", rests=(apart,))


def test_a_rig_s_own_parameters_may_be_held(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mutant killed: symbols that only the house has."""
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "toys")
    rig, record = importlib.import_module("toy_rig").Damped(), noisy_step(SIGMA)
    free = tuple(name for name in ORDER if name not in ("j_1", "r_m"))
    plain = posterior(record, SIGMA, free=free)
    space = dataclasses.replace(
        plain.space, model=rig.parameters, fixed={**plain.space.fixed, "tau_s": 0.01}
    )
    (one,) = plain.likelihood.observations
    likelihood = likelihood_of(space, (Response(rig, record), one.noise))
    target = Posterior(space=space, likelihood=likelihood, coordinates=space.coordinates)
    theta = space.vector(space.start)
    assert sets(rests(target, theta)) == {
        (MECHANICAL - {"j_1"}, frozenset({"j_1"})),
        (ELECTRICAL - {"r_m"}, frozenset({"r_m"})),
    }
