"""The missing torque of a posterior: draws of it, what it moves, and what is shown.

Mutants killed: a torque that is drawn without the record, a band of one draw of the unknowns
alone, a sign.
"""

from __future__ import annotations

import csv
import dataclasses
import io

import numpy as np
import pytest
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL
from support.small_problems import STATES, experiment, posterior, unknown, vector

from bayesdrill.analysis.latent_torque import TorqueEstimate, torque_estimates
from bayesdrill.analysis.run_analysis import torque_summary
from bayesdrill.basics.units import Unit
from bayesdrill.inference.likelihood import LatentTorqueObservation
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.inference.priors import LogUniform
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.report.sections import torque_words
from bayesdrill.report.sections.physics_figure import torque_figure
from bayesdrill.rig.models.latent_torque import MissingTorque, TorqueLocation
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.kalman import KalmanFilter
from bayesdrill.rig.simulators.linear import Response

SIZE, TIME, SIGMA = 0.1, 0.3, 0.05
SPEEDS = {name: {name: 1.0} for name in STATES[:4]}


def shaken(at: TorqueLocation, rng: np.random.Generator) -> tuple[Posterior, np.ndarray]:
    """A posterior of a record, which a drawn torque has shaken; and that torque in N m."""
    t = 0.02 * np.arange(301)
    voltage = {"v": 8.0 * np.sin(1.3 * t)}
    one = experiment(301, 0.02, measures=SPEEDS, series=voltage, constant={"t_1": 0.0})
    found = KalmanFilter(MotorShaft(), MissingTorque(at=at, smoothness="3/2"), one)
    row, sigmas = np.append(vector(NOMINAL), [SIZE, TIME])[None], np.full((1, 4), SIGMA)
    states, shows = found.draw(row, sigmas, rng)
    clean = Response(MotorShaft(), one).signals(row[:, :-2])[0]
    one = dataclasses.replace(one, y=clean + shows[0])
    base = posterior(one, np.full(4, SIGMA), priors={})
    levels = {
        n: dataclasses.replace(unknown(n, LogUniform(1e-3, 10.0)), role="noise")
        for n in ("s_d", "tau_d")
    }
    observed = LatentTorqueObservation(
        response=Response(MotorShaft(), one),
        noise=White(n_samples=301, known=dict.fromkeys(range(4), SIGMA), n_channels=4),
        kalman_filter=KalmanFilter(MotorShaft(), found.torque, one),
        process=levels,
        parameters=base.space.model,
        noise_names=["s_d", "tau_d"],
    )
    space = ParameterSpace(
        model=base.space.model, unknowns=(*base.space.unknowns, *observed.unknowns), fixed={}
    )
    likelihood = Likelihood.joint(space, [observed])
    made = Posterior(space=space, likelihood=likelihood, coordinates=space.coordinates)
    return made, SIZE * states[0, :, found.augmented.states.index("torque")]


def seen(at: TorqueLocation, seed: int, n: int = 200) -> tuple[TorqueEstimate, np.ndarray]:
    rng = np.random.default_rng(seed)
    target, truth = shaken(at, rng)
    theta = np.append(vector(NOMINAL), [SIZE, TIME])
    (found,) = torque_estimates(target, np.repeat(theta[None], n, axis=0), rng)
    return found, truth


@run_cases("at", ["motor", "rotor_1"])
def test_the_torque_is_found_and_its_band_holds_it(at: TorqueLocation) -> None:
    """Of 301 samples 94 % and no less than 85: they hang together."""
    found, truth = seen(at, 4)
    low, high = found.band
    assert np.mean((truth >= low) & (truth <= high)) > 0.85
    assert np.corrcoef(found.expected, truth)[0, 1] > 0.9
    assert np.sqrt(np.mean((found.expected - truth) ** 2)) < 0.6 * SIZE
    spread = np.sqrt(np.mean((found.draws - found.draws.mean(axis=0)) ** 2))
    assert np.sqrt(np.mean((found.expected - truth) ** 2)) == pytest.approx(spread, rel=0.35)


def test_draws_have_the_mean_that_is_expected_and_differ_as_unknowns_do() -> None:
    found, _ = seen("rotor_1", 5, n=600)
    error = found.draws.std(axis=0) / np.sqrt(600)
    assert np.abs((found.draws.mean(axis=0) - found.expected) / error).max() < 4.5
    rng = np.random.default_rng(5)
    target, _ = shaken("rotor_1", rng)
    theta = np.repeat(np.append(vector(NOMINAL), [SIZE, TIME])[None], 600, axis=0)
    theta[:, 7] *= np.linspace(0.7, 1.3, 600)
    (wider,) = torque_estimates(target, theta, rng)
    assert wider.draws.std(axis=0).mean() > 1.1 * found.draws.std(axis=0).mean()


def test_what_it_moves_is_what_was_left_without_it() -> None:
    """And the noise of the sensor remains."""
    found, _ = seen("rotor_1", 6)
    for one in found.courses:
        assert one.left == pytest.approx(SIGMA, rel=0.15)
        assert one.moved == pytest.approx(np.sqrt(one.without**2 - SIGMA**2), rel=0.1)
    assert found.states["w_1"].shape == found.t.shape
    assert found.rig.roles.inertia("motor").reduction == 0.125


def test_it_is_drawn_said_and_written() -> None:
    found, _ = seen("motor", 7)
    figure = torque_figure(found, clock=Unit("s", 1.0, "s"))
    panels = sorted(figure.axes, key=lambda panel: panel.get_position().y1)
    labels = [panel.get_xlabel() for panel in panels]
    assert labels[-1].startswith("time")
    assert any("speed of the motor" in label for label in labels)
    assert any("voltage" in label for label in labels)
    assert "at the motor" in torque_words.torque_sentence(torque_summary(found), found.rig)
    text = torque_words.torque_csv([found])
    assert text is not None
    rows = list(csv.DictReader(io.StringIO(text)))
    assert len(rows) == 301
    assert float(rows[7]["torque"]) == found.expected[7]
    assert torque_words.torque_csv([]) is None
