"""How inputs move channels by frequency: the model's response, and what a record says of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, matrices
from support.small_problems import experiment, posterior, posterior_of

from bayesdrill.analysis.prediction import MAX_RELATIVE_SD, FrequencyResponse, frequency_responses
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.sensors import ObservationModel

Array = NDArray[np.float64]

N, DT = 3600, 0.01  # in segments of 800: frequencies are multiples of 1/8 Hz
MEASURES = {"theta_1": {"theta_1": 1.0, "theta_2": -1.0}, "w_2": {"w_2": 1.0}}
SENSING = ObservationModel(
    gains={"w_2": "gain"}, lags={"theta_1": "lag"}, input_gains={"v": "supply"}
)
SENSORS = {"gain": 1.3, "lag": 0.017, "supply": 0.8}


def target(series: dict[str, Array], *, first_order: bool) -> Posterior:
    """With a gain, a lag and an input's gain that are known; only k_s is not."""
    record = experiment(
        N, DT, series=series, constant={}, measures=MEASURES, first_order=first_order
    )
    rig = simulator(MotorShaft(), record, SENSING)
    return posterior_of(rig, (0.1, 0.1), {"k_s": Uniform(0.1, 1.0)}, NOMINAL | SENSORS)


@run_cases("first_order", [False, True])
def test_the_model_s_is_what_a_sine_leaves(first_order: bool) -> None:
    """By the simulator: the second half of a record, all else fitted and taken away (the shaft's own
    motion, which hardly dies away).

    Mutants killed: a lag that leads, a hold without its delay, a gain of another channel.
    """
    rng, theta = np.random.default_rng(1), np.array([NOMINAL["k_s"]])
    series = {"v": rng.standard_normal(N), "t_1": 0.1 * rng.standard_normal(N)}
    found = frequency_responses(target(series, first_order=first_order), theta)
    assert [(one.channel.name, one.input.name) for one in found] == [
        (channel, name) for channel in MEASURES for name in series
    ]
    t = DT * np.arange(N)
    own = np.linalg.eigvals(matrices(NOMINAL)[0])
    slow = own[np.abs(own.real) < 1]
    fading = [f(np.exp(root * t)) for root in slow for f in (np.real, np.imag)]
    for name in series:
        for rate in (0.25, 2.0, 6.0):
            wave = {other: np.sin(2 * np.pi * rate * t) * (other == name) for other in series}
            signals = target(wave, first_order=first_order).likelihood.signals(theta[None])[0]
            phase = 2 * np.pi * rate * t
            parts = np.stack([np.sin(phase), np.cos(phase), *fading], axis=-1)[N // 2 :]
            sine, cosine = np.linalg.lstsq(parts, signals[N // 2 :], rcond=None)[0][:2]
            for k, channel in enumerate(MEASURES):
                one = next(x for x in found if (x.channel.name, x.input.name) == (channel, name))
                at = np.abs(one.frequencies - rate).argmin()
                assert one.frequencies[at] == pytest.approx(rate)
                assert one.modelled[at] == pytest.approx(sine[k] + 1j * cosine[k], rel=0.01)


def driven(k_s: float, seed: int) -> tuple[Posterior, Array]:
    """A record of the nominal rig under two inputs that are not independent, and a model of it."""
    rng, n = np.random.default_rng(seed), 6000
    v = 4.0 * rng.standard_normal(n)
    t_1 = 0.5 * rng.standard_normal(n) + 0.05 * v
    record = experiment(n, DT, series={"v": v, "t_1": t_1}, constant={}, measures=MEASURES)
    sigma = np.array([0.005, 0.5])
    rig = posterior(record, sigma, free=("k_s",))
    y = rig.likelihood.signals(np.array([[NOMINAL["k_s"]]]))[0]
    y = y + sigma * rng.standard_normal(y.shape)
    record = dataclasses.replace(record, y=y)
    return posterior(record, sigma, free=("k_s",)), np.array([k_s])


def off(found: FrequencyResponse, truth: FrequencyResponse) -> Array:
    """In sds of magnitude, where the input excites."""
    seen = np.isfinite(found.measured)
    assert (found.error[seen] <= MAX_RELATIVE_SD).all()
    sd = found.error * np.abs(found.measured)
    return np.asarray(np.abs(found.measured - truth.modelled)[seen] / sd[seen])


def test_what_is_measured_is_the_rig_s_whatever_the_model_is() -> None:
    """A shaft that is a tenth too stiff; each of two inputs that have to do with each other.

    Mutants killed: errors of another size; inputs one by one; conjugated cross-spectra.
    """
    right: dict[tuple[str, str], list[Array]] = {}
    bad: dict[tuple[str, str], list[Array]] = {}
    for seed in range(6):
        truth = frequency_responses(*driven(NOMINAL["k_s"], seed))
        wrong = frequency_responses(*driven(1.1 * NOMINAL["k_s"], seed))
        for one, other in zip(wrong, truth, strict=True):
            name = (one.channel.name, one.input.name)
            right.setdefault(name, []).append(off(other, other))
            bad.setdefault(name, []).append(off(one, other))
    for every in (right, bad):
        for name in (("theta_1", "v"), ("theta_1", "t_1"), ("w_2", "v")):
            away = np.concatenate(every[name])
            assert len(away) > 100
            assert 0.9 < np.sqrt(np.mean(away**2) / 2) < 1.3  # magnitude and phase
    twist = wrong[0]
    seen = np.isfinite(twist.measured)
    sd = twist.error * np.abs(twist.measured)
    assert np.max(np.abs(twist.measured - twist.modelled)[seen] / sd[seen]) > 8


def test_nothing_is_said_without_an_input_or_equal_steps() -> None:
    record = experiment(200, DT, measures=MEASURES)
    still = posterior(record, np.array([0.1, 0.1]), free=("k_s",))
    assert frequency_responses(still, np.array([NOMINAL["k_s"]])) == ()
