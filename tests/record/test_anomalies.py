"""Spikes, stuck and clipped samples, turns and differences: detected where they are, and only there."""

from itertools import product

import numpy as np
from scipy.signal import lfilter
from support.case_tables import run_cases

from bayesdrill.record import anomalies

T = np.arange(2001) * 0.005
RNG = np.random.default_rng(11)
NOISE = 0.01 * RNG.standard_normal(len(T))
SWING = np.sin(3.0 * T) * np.exp(-0.2 * T) + 0.3
SQUARE = np.where(np.sin(4.0 * T) > 0, 8.0, -3.0)
WORD = np.repeat(RNG.integers(0, 2, 2001), 5)[: len(T)] * 5.0  # a binary sequence, as inputs are
PWM = np.where(np.arange(len(T)) % 12 < 3, 24.0, 0.0)
SLIP = np.clip(np.sin(9.0 * T), 0.0, None) * 20.0  # stick-slip: at rest, then off
SWEEP = np.sin(2.0 * T**2)
RINGING = np.where(T < 4.0, 0.0, 1.0 - np.exp(-6 * (T - 4.0)) * np.cos(40.0 * (T - 4.0)))
INRUSH = np.where(T < 4.0, 0.0, 1.0 + 7.0 * np.exp(-60.0 * np.clip(T - 4.0, 0.0, None)))

SOUND = {
    "noise": NOISE,
    "long tails": RNG.laplace(size=len(T)),
    "swing": SWING + NOISE,
    "swing without noise": SWING,
    "square": SQUARE,
    "square with noise": SQUARE + NOISE,
    "steps up": np.floor(T),
    "binary sequence": WORD,
    "pulse width": PWM,
    "stick-slip": SLIP + NOISE,
    "stick-slip without noise": SLIP,
    "sweep": SWEEP + NOISE,
    "ringing after a step": RINGING + 0.1 * NOISE,
    "inrush of a current": INRUSH + NOISE,
    "coarse angle": np.round(SWING, 1),
    "coarse speed": np.round(np.gradient(np.round(SWING, 2), T), 6),
    "counted slowly": np.floor(0.7 * T) + (RNG.random(len(T)) < 0.01),
    "ramp": 5.0 * T + NOISE,
    "constant": np.full(len(T), 2.5),
    "short": SWING[:20],
}
OF_INPUTS = ("square", "binary sequence", "pulse width", "steps up")


def test_short_and_long_records_have_the_same_running_medians() -> None:
    x = np.random.default_rng(4).normal(size=anomalies.MAX_NUMPY_MEDIAN + 1).cumsum()
    part = anomalies._running_median(x[:-1], 25)
    assert np.array_equal(part[:-12], anomalies._running_median(x, 25)[: len(part) - 12])


@run_cases("name", SOUND)
def test_sound_signals_have_no_spikes_and_no_clipped_samples(name: str) -> None:
    assert len(anomalies.spikes(SOUND[name])) == 0
    if name not in OF_INPUTS:
        assert len(anomalies.saturated(SOUND[name])) == 0


@run_cases(
    "name, width, sign",
    product(
        ["swing", "square with noise", "stick-slip", "coarse angle", "ramp"], [1, 2, 5, 12], [1, -1]
    ),
)
def test_spikes_are_detected_at_their_samples(name: str, width: int, sign: int) -> None:
    clean, places = SOUND[name], np.array([137, 651, 1408])
    x = clean.copy()
    for first in places:
        x[first : first + width] += sign * 4.0 * np.ptp(clean)
    spikes = anomalies.spikes(x)
    assert spikes.first.tolist() == places.tolist()
    # A spike beside an edge of the signal itself takes one sample more.
    beside_an_edge = name == "square with noise" and width == 5
    excess = spikes.last - (places + width - 1)
    assert sorted(excess) == [0, 0, int(beside_an_edge)]


def test_a_response_to_a_jump_of_an_input_is_no_spike() -> None:
    x = NOISE.copy()
    x[400:404] += 2.0
    x[1200:1204] += 2.0
    jumps = np.zeros(len(x), dtype=bool)
    jumps[399] = True
    assert anomalies.spikes(x).first.tolist() == [400, 1200]
    assert anomalies.spikes(x, jumps).first.tolist() == [1200]


def test_in_inputs_only_the_shortest_spikes_count() -> None:
    x = SQUARE.copy()
    x[700:705] += 80.0
    x[1500] -= 80.0
    assert anomalies.spikes(x, wide=False).first.tolist() == [1500]


def test_stuck_samples_show_only_where_no_others_are_repeated() -> None:
    noisy = SWING + NOISE
    stuck = noisy.copy()
    stuck[800:830] = stuck[800]
    spans = anomalies.stuck(stuck)
    assert (spans.first.tolist(), spans.last.tolist()) == ([800], [829])
    at_the_end = noisy.copy()
    at_the_end[-30:] = at_the_end[-30]
    assert anomalies.stuck(at_the_end).first.tolist() == [len(T) - 30]
    coarse, switched_off = np.round(stuck, 1), np.where(T < 1, 0.0, noisy)
    for x in (coarse, switched_off, noisy):
        assert len(anomalies.stuck(x)) == 0


@run_cases("digits", [2, 12])
def test_clipped_samples_are_detected_at_either_end_of_a_range(digits: int) -> None:
    tone = np.round(3.0 * np.sin(5.0 * T) + NOISE + 1.0, digits)
    for clipped, end in ((np.minimum(tone, 3.0), 3.0), (np.maximum(tone, -1.0), -1.0)):
        spans = anomalies.saturated(clipped)
        assert len(spans) >= 3
        assert np.all(clipped[spans.mask(len(T))] == end)
        assert spans.count > 0.9 * np.sum(clipped == end)
    assert len(anomalies.saturated(tone)) == 0


DT = 0.004
TIMES = np.arange(1500) * DT
TURNING = 25.0 * TIMES + 9.0 * np.sin(4.0 * TIMES)  # forth and back again
SPEED = 25.0 + 36.0 * np.cos(4.0 * TIMES)
OWN = np.random.default_rng(8).standard_normal((2, len(TIMES)))
ANGLE = TURNING + 0.002 * OWN[0]
BACKWARD = np.diff(ANGLE, prepend=TURNING[0]) / DT
MEASURED = SPEED + 0.3 * OWN[1]


def test_a_jump_of_half_a_period_is_ambiguous() -> None:
    x = np.array([0.0, 10.0, 195.0, 200.0, 20.0])
    assert anomalies.ambiguous(x, 360.0).tolist() == [2, 4]


def test_the_nearest_difference_quotient_is_named() -> None:
    for kind, w in anomalies.quotients(ANGLE, TIMES).items():
        nearest, off = anomalies.nearest_quotient(ANGLE, np.r_[0.0, w, 0.0], TIMES)
        assert nearest == kind
        assert off < 1e-12


@run_cases(
    "speed",
    [
        BACKWARD,
        3.7 * BACKWARD,  # in another unit
        np.gradient(ANGLE, TIMES),
        lfilter([0.2], [1.0, -0.8], BACKWARD),
        np.convolve(BACKWARD, np.ones(4) / 4, mode="same"),
    ],
    ids=["backward", "scaled", "central", "filtered", "smoothed"],
)
def test_differences_of_an_angle_are_recognised(speed: np.ndarray) -> None:
    assert anomalies.differenced(ANGLE, speed, DT)


@run_cases(
    "angle, speed",
    [
        (ANGLE, MEASURED),
        (TURNING, SPEED),
        (ANGLE, SPEED),
        (TURNING, MEASURED),
        (np.round(TURNING, 2), np.round(SPEED, 1)),
        (ANGLE, BACKWARD + 0.03 * OWN[1]),
    ],
)
def test_a_speed_that_was_measured_has_noise_of_its_own(
    angle: np.ndarray, speed: np.ndarray
) -> None:
    assert not anomalies.differenced(angle, speed, DT)
