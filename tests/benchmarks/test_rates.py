"""A few records of each rate, which tell already what hundreds tell."""

from __future__ import annotations

import numpy as np
from support.case_tables import run_cases

from bayesdrill.analysis.latent_torque import torque_estimates
from bayesdrill.report.sections.torque_words import HARMLESS
from bayesdrill.rig.simulators.stepped import Stepped
from benchmarks.rates import noise, rubbing_torque, torque
from benchmarks.rates.records import TORQUE, observed, of


def test_intervals_hold_the_truth_and_friction_is_named() -> None:
    """Mutant killed: a missing torque that is drawn without the record."""
    every = [torque.told(seed) for seed in range(3)]
    assert sum(torque.held(every).values()) >= 0.75 * len(every) * len(every[0].below)
    assert torque.named(every) == len(every)
    assert min(one.within for one in every) > 0.85


def test_beside_friction_a_small_torque_is_found_and_a_large_one_said_to_stray() -> None:
    """Mutant killed: a torque that takes the friction's part, or the friction the torque's."""
    one = rubbing_torque.told(1)
    assert sum(rubbing_torque.held([one]).values()) >= 5
    assert one.alike > 0.8
    assert rubbing_torque.strayed(rubbing_torque.LARGE, 2) > HARMLESS


def test_noise_that_remembers_is_to_be_told_of() -> None:
    """Mutants killed: a likelihood that takes neighbours for independent, information without them."""
    white, told = noise.held("white", 12), noise.held("ar1", 12)
    assert sum(white[name] for name in noise.FREE) < 0.6 * 12 * len(noise.FREE)
    assert sum(told[name] for name in noise.FREE) > 0.8 * 12 * len(noise.FREE)


@run_cases("at", ["rotor_1", "motor"])
def test_where_nothing_rubs_the_rig_goes_where_the_torque_moves_it(at: str) -> None:
    """Kills a sign, a gear, a torque that is held half a step late."""
    missing = {**TORQUE, "at": at, "smoothness": "3/2"}
    target = observed(rubs={"t_c1": 0.0}, missing_torque=missing)
    one, rng = target.likelihood.observations[0], np.random.default_rng(3)
    assert isinstance(one.response, Stepped)
    space = target.space
    theta = space.vector({**space.start, "s_d": 0.1, "tau_d": 1.0})
    full = space.full(theta[None])
    y = one.draw(one.signals(full), theta[None], rng)[0]
    (found,) = torque_estimates(of(target, one.with_record(y)), theta[None], rng)
    assert max(course.moved for course in found.courses) > 0.5
    assert max(course.strayed for course in found.courses) < 0.1
