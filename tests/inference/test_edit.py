"""A posterior that is edited: what is changed is, and all else stays as it is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.friction_cases import CASES
from support.missing_physics import MEASURES, believed
from support.stepped_friction import experiment_of, model_of, parameters

from bayesdrill.inference import step_error
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.rig.models import PARAMETERS
from bayesdrill.rig.models.linear import with_named
from bayesdrill.rig.simulators.sensors import ObservationModel

CASE = CASES["falling"]
MODEL = model_of(CASE)
KNOWN = dict(zip(MODEL.parameters, parameters(CASE)[0], strict=True))


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    """Of a rig that is stepped, one experiment with a twin that is held out."""
    found = step_error.with_steps(
        believed(experiment_of(CASE, MEASURES), MODEL, **KNOWN), {"": (2, 3)}
    )
    likelihood = found.likelihood
    twin = dataclasses.replace(likelihood.only_observation, label="twin")
    twins = dataclasses.replace(likelihood, held_out=(twin,))
    return dataclasses.replace(found, likelihood=twins)


def at(posterior: Posterior, **more: float) -> np.ndarray:
    return posterior.space.vector({**posterior.space.start, **more})[None]


def test_nothing_changed_is_the_same(posterior: Posterior) -> None:
    same = posterior.edit()
    assert same.space is posterior.space
    assert same.density(at(posterior)) == posterior.density(at(posterior))
    assert step_error.chosen_steps(same) == {"": (2, 3), "twin": (2, 3)}


def test_what_was_held_is_unknown_where_it_was(posterior: Posterior) -> None:
    """The likelihood is the same there, and moves with it; it stands behind the rig's unknowns."""
    space = posterior.space
    name = next(name for name in space.model if name in space.fixed and space.fixed[name] > 0)
    value = space.fixed[name]
    new = Unknown(
        symbol=PARAMETERS[name], role="rig", prior=Uniform(0.5 * value, 2 * value), start=value
    )
    freed = posterior.edit(free=[new])
    rig = len(space.columns("rig", "quantity"))
    assert freed.space.free == (*space.free[:rig], name, *space.free[rig:])
    assert freed.likelihood(at(freed)) == posterior.likelihood(at(posterior))
    assert freed.likelihood(at(freed, **{name: 1.1 * value})) != posterior.likelihood(at(posterior))
    assert [one.label for one in freed.likelihood.held_out] == ["twin"]


def test_another_record_is_what_is_explained(posterior: Posterior) -> None:
    theta = at(posterior)
    signals = posterior.likelihood.signals(theta)
    clean = posterior.edit(records=[*signals])
    assert clean.likelihood.mean_square(theta) < 1e-24
    assert posterior.likelihood.mean_square(theta) > 0.1
    with pytest.raises(ValueError, match="longer"):
        posterior.edit(records=[*signals, *signals])


def test_another_rig_and_sensors_take_the_same_steps(posterior: Posterior) -> None:
    """With damping that is none, and a gain of one, nothing is other than it was.

    Mutant killed: what is tried is tried in other steps than the fit has.
    """
    channel = posterior.likelihood.only_observation.experiment.names[0]
    damped = posterior.edit(
        free=[
            Unknown(
                symbol=dataclasses.replace(PARAMETERS["c_s"], name=name),
                role="sensor",
                prior=Uniform(0.0, 2.0),
                start=start,
            )
            for name, start in (("c_s", 0.0), ("gain", 1.0))
        ],
        each=lambda one: one.for_rig(
            with_named(one.response.model, ["c_s"]), ObservationModel(gains={channel: "gain"})
        ),
    )
    assert step_error.chosen_steps(damped) == step_error.chosen_steps(posterior)
    assert damped.likelihood(at(damped)) == posterior.likelihood(at(posterior))
    assert damped.likelihood(at(damped, c_s=1e-3)) != posterior.likelihood(at(posterior))
    assert damped.likelihood(at(damped, gain=1.1)) != posterior.likelihood(at(posterior))
