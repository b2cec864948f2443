"""Figures of the paper's matrix, Table 2 and fit: nothing overlaps, numbers are in their places."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray
from pictures import clashes, drawn, marked, within, xy

from bayesdrill.basics.symbols import PARAMETERS
from bayesdrill.paper import printed
from bayesdrill.paper.forward import READINGS, MatrixReading
from bayesdrill.paper.plots import SHORT, readings_figure, verification_figure
from bayesdrill.paper.searches import Verification

Array = NDArray[np.float64]

SIGMAS = (0.001, 0.01, 0.1, 1.0)
BOUNDS = {"c_m": 0.0072, "k_e": 0.0198}  # at sigma 1, SI


def si(label: str, u: Array) -> Array:
    """What a reader of the axis makes of the numbers u on it."""
    power = re.search(r"\[\$10\^\{(-?\d+)\}", label)
    return u * 10.0 ** (int(power[1]) if power else 0)


# The printed matrix


def readings() -> tuple[MatrixReading, ...]:
    t = np.linspace(0.0, 10.0, 401)
    fast = 1 - np.exp(-t / 0.03)
    curves = (
        16 * fast + np.sin(3 * t),
        16 * fast * np.exp(-t / 5),
        660 * (1 - np.exp(-t)),
        -260 * np.exp(-0.2 * t) * np.sin(6 * t),
    )
    ends = (15.913, 1e-15, 660.26, -0.02)
    found = [
        MatrixReading(
            row={"name": name, "matrix": matrix, "time": 10.0, "w_end": end},
            t=t,
            curve=curve,
        )
        for (name, (matrix, _)), curve, end in zip(READINGS.items(), curves, ends, strict=True)
    ]
    return tuple(found)


def test_readings_are_all_on_the_left_and_the_right_one_is_large_on_the_right() -> None:
    found = readings()
    figure = readings_figure(found)
    assert not list(clashes(drawn(figure)))
    left, right = figure.axes
    for reading, line in zip(found, left.get_lines(), strict=True):
        np.testing.assert_allclose(si(left.get_ylabel(), xy(line)[1]), reading.curve, rtol=1e-12)
        assert within(left, xy(line)[1])
    first = xy(right.get_lines()[0])[1]
    assert within(right, first)
    assert np.ptp(first) > 0.5 * np.ptp(right.get_ylim())
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    for label, end in zip(labels, ("15.9", "0", "660.3", "0"), strict=True):
        assert label.endswith(f"settles at {end} rad/s")


def test_every_reading_has_a_short_name() -> None:
    assert set(SHORT) == set(READINGS)
    assert len(set(SHORT.values())) == len(READINGS)


# Table 2


def verification(records: int) -> Verification:
    """Estimates far from normal: by fminsearch half as far off again, and one exact."""
    rng = np.random.default_rng(3)
    names = ("c_m", "k_e")
    truth = np.array([printed.GUESS[name] for name in names])
    bound = np.array([BOUNDS[name] for name in names])
    z = rng.standard_exponential((records, 2)) * rng.choice([-1, 1], (records, 2))
    z[0] = 0.0
    found = {
        way: {s: truth + wide * s * bound * z for s in SIGMAS}
        for way, wide in (("fminsearch", 1.5), ("scaled", 1.0))
    }
    values = {
        s: {
            "truth": truth,
            "bound": s * bound,
            **{f"sd_{way}": rows[s].std(axis=0, ddof=1) for way, rows in found.items()},
        }
        for s in SIGMAS
    }
    return Verification(
        names=names, records=records, values=values, estimates=found, converged=True
    )


def test_errors_and_bounds_stand_at_their_sigmas_in_per_cent() -> None:
    v = verification(60)
    figure = verification_figure(v, printed.TWO_PARAMETERS)
    assert not list(clashes(drawn(figure)))
    for k, (panel, name) in enumerate(zip(figure.axes, v.names, strict=True)):
        percent = {
            what: [100 * own[what][k] / own["truth"][k] for own in v.values.values()]
            for what in ("bound", "sd_fminsearch", "sd_scaled")
        }
        (bound,) = (line for line in panel.get_lines() if line.get_marker() == "None")
        np.testing.assert_allclose(xy(bound), [SIGMAS, percent["bound"]])
        (fminsearch,) = (line for line in marked(panel, "o", filled=False))
        np.testing.assert_allclose(xy(fminsearch)[1], percent["sd_fminsearch"])
        (scaled,) = marked(panel, "+")
        np.testing.assert_allclose(xy(scaled)[1], percent["sd_scaled"])
        (paper,) = marked(panel, "D")
        expected = [printed.TWO_PARAMETERS[s][name].deviation for s in SIGMAS]
        np.testing.assert_array_equal(xy(paper), [SIGMAS, expected])
        assert all(within(panel, xy(line)[1]) for line in (bound, fminsearch, scaled, paper))
        assert panel.get_xscale() == panel.get_yscale() == "log"
        assert rf"${PARAMETERS[name].latex}$" in panel.get_ylabel()


def test_a_row_that_the_paper_does_not_print_is_left_out() -> None:
    some = {0.01: {"c_m": printed.Estimate("19.0e-5", "0.77")}}
    figure = verification_figure(verification(3), some)
    assert not list(clashes(drawn(figure)))
    counts = [xy(marked(panel, "D")[0]).shape[1] for panel in figure.axes]
    assert counts == [1, 0]
