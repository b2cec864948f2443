"""Spikes, stuck counts, ends of a range: found where they were put, and nowhere in sound signals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.case_tables import for_each

from bayesdrill.record import anomalies
from bayesdrill.record.formats import FORMATS, format_of
from bayesdrill.record.formats.table import RecordTable

ROOT = Path(__file__).parents[2]
SHARED = ROOT.parent / "shared" / "data"
RECORDS = sorted((ROOT / "configs").rglob("*.csv"))

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


def test_there_are_records() -> None:
    assert len(RECORDS) >= 6


def test_medians_of_a_short_record_are_those_of_a_long_one() -> None:
    x = np.random.default_rng(4).normal(size=anomalies.MAX_NUMPY_MEDIAN + 1).cumsum()
    part = anomalies._running_median(x[:-1], 25)
    assert np.array_equal(part[:-12], anomalies._running_median(x, 25)[: len(part) - 12])


def test_sound_signals_have_none() -> None:
    def check(name: str) -> None:
        assert len(anomalies.spikes(SOUND[name])) == 0
        if name not in ("square", "binary sequence", "pulse width", "steps up"):  # of inputs
            assert len(anomalies.saturated(SOUND[name])) == 0

    for_each({str(name): (name,) for name in SOUND}, check)


def test_records_of_the_house_have_none() -> None:
    def check(path: Path) -> None:
        for name, x in _table(path).variables.items():
            assert len(anomalies.spikes(x)) == 0, name
            assert len(anomalies.saturated(x)) == 0, name
            assert len(anomalies.stuck(x)) == 0, name

    for_each({str(path.stem): (path,) for path in RECORDS}, check)


def test_spikes_are_found_where_they_were_put() -> None:
    """Mutants killed: one sign, one width, a departure that is not measured from the signal's course."""
    bases = ["swing", "square with noise", "stick-slip", "coarse angle", "ramp"]

    def check(base: str, width: int, sign: int) -> None:
        clean, places = SOUND[base], [137, 651, 1408]
        x = clean.copy()
        for at in places:
            x[at : at + width] += sign * 4.0 * np.ptp(clean)
        found = anomalies.spikes(x)
        assert found.first.tolist() == places
        over = found.last - np.array([at + width - 1 for at in places])
        assert np.all(
            (over >= 0) & (over <= 1)
        )  # beside an edge of the signal itself one sample more
        assert np.sum(over) == (base == "square with noise" and width == 5)

    for_each(
        {
            f"{base} {width} {sign}": (base, width, sign)
            for base in bases
            for width in [1, 2, 5, 12]
            for sign in [1, -1]
        },
        check,
    )


def test_what_an_input_has_just_caused_is_the_rigs() -> None:
    x = NOISE.copy()
    x[400:404] += 2.0
    x[1200:1204] += 2.0
    jumps = np.zeros(len(x), dtype=bool)
    jumps[399] = True
    assert anomalies.spikes(x).first.tolist() == [400, 1200]
    assert anomalies.spikes(x, jumps).first.tolist() == [1200]


def test_in_inputs_only_the_shortest_count() -> None:
    x = SQUARE.copy()
    x[700:705] += 80.0
    x[1500] -= 80.0
    assert anomalies.spikes(x, wide=False).first.tolist() == [1500]


def test_stuck_samples_show_only_where_no_others_are_repeated() -> None:
    noisy = SWING + NOISE
    stuck = noisy.copy()
    stuck[800:830] = stuck[800]
    found = anomalies.stuck(stuck)
    assert (found.first.tolist(), found.last.tolist()) == ([800], [829])
    end = noisy.copy()
    end[-30:] = end[-30]
    assert anomalies.stuck(end).first.tolist() == [len(T) - 30]
    assert len(anomalies.stuck(np.round(stuck, 1))) == 0  # a coarse sensor repeats by itself
    assert len(anomalies.stuck(np.where(T < 1, 0.0, noisy))) == 0  # switched off
    assert len(anomalies.stuck(noisy)) == 0


def test_a_range_that_ends_shows_at_either_end() -> None:
    def check(digits: int) -> None:
        tone = np.round(3.0 * np.sin(5.0 * T) + NOISE + 1.0, digits)
        for clipped, end in ((np.minimum(tone, 3.0), 3.0), (np.maximum(tone, -1.0), -1.0)):
            found = anomalies.saturated(clipped)
            assert len(found) >= 3
            assert np.all(clipped[found.mask(len(T))] == end)
            assert found.count > 0.9 * np.sum(clipped == end)
        assert len(anomalies.saturated(tone)) == 0

    for_each({str(digits): (digits,) for digits in [2, 12]}, check)


# --- records of rigs of others ---------------------------------------------------------------------


def _table(path: Path) -> RecordTable:
    if not path.exists():
        pytest.skip(f"{path.name} is not here")
    one = FORMATS[format_of(path)]
    return one.read(path, one.options(), None)


def test_the_glitches_of_a_drill_string_are_found_and_nothing_else() -> None:
    """UFRJ: the top speed, about 90 rpm, falls below -100 rpm in pulses of 10 ms; no other column does.

    All pulses are in: what is left is never below -10 rpm, where the speed dips to about 0 as the bit
    sticks.  Nothing else is: every burst reaches -100 rpm or less.  And nearly all samples below 0 are.
    """
    table = _table(SHARED / "ufrj_drillstring_rig" / "175_completo_1.mat")
    top = table.pick(variable="Top_Speed_Sample_175_complete")
    t = table.pick(variable="Time_Sample_175_complete")
    found = anomalies.spikes(top)
    mask = found.mask(len(top))
    assert top[~mask].min() > -10.0
    assert all(top[a : b + 1].min() < -100.0 for a, b in zip(found.first, found.last, strict=True))
    assert np.sum(top < 0) == 1790
    assert np.sum((top < 0) & mask) > 0.95 * 1790
    assert np.mean(mask) < 0.04
    blocks = [(28.0, 29.5), (50.0, 52.0), (56.3, 58.0)]
    dense = [int(np.sum((t[found.first] >= a) & (t[found.first] < b))) for a, b in blocks]
    assert min(dense) > 25
    assert sum(dense) > 0.7 * len(found)
    for name in ("Bit_Speed", "Bit_Torque", "WOB"):
        assert len(anomalies.spikes(table.pick(variable=f"{name}_Sample_175_complete"))) == 0


def test_a_servo_with_coarse_sensors_has_none() -> None:
    def check(name: str) -> None:
        table = _table(SHARED / "simulated_servo" / f"{name}.csv")
        for x in table.variables.values():
            assert len(anomalies.spikes(x)) == 0
        for column in ("theta [deg]", "alpha [deg]"):
            assert len(anomalies.saturated(table.pick(column))) == 0
            assert len(anomalies.stuck(table.pick(column))) == 0

    for_each({name: (name,) for name in ["square", "sweep", "slow"]}, check)


def test_a_servo_pair_has_none_but_those_of_its_transfer() -> None:
    """HSM150: single samples of the speed are off by seven counts, all at one place of a block of 512.

    And a single sample of the current (of which the torque is computed) has the other sign.
    """

    def check(force: str, number: int) -> None:
        table = _table(SHARED / "hsm150_servo" / f"idf_pos_0.{force}_{number}.mat")
        angle, speed, current = (table.pick(column, "data") for column in (3, 4, 7))
        assert len(anomalies.spikes(angle)) == 0
        found = anomalies.spikes(speed)
        assert set((found.first % 512).tolist()) <= {481}
        assert np.all(found.first == found.last)
        odd = anomalies.spikes(current)
        assert odd.first.tolist() == ([16482] if (force, number) == ("065", 2) else [])
        for x in (angle, speed, current):
            assert len(anomalies.saturated(x)) == 0
            assert len(anomalies.stuck(x)) == 0

    for_each(
        {f"{force} {number}": (force, number) for force in ["06", "065"] for number in [1, 2, 3]},
        check,
    )
