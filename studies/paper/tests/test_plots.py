"""Figures of the studies: nothing overlaps, and every mark is in its place."""

import re
from collections.abc import Sequence

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from support.case_tables import run_cases
from support.figure_checks import SYMBOLS, clashes, drawn, marked, posterior, within, xy

from bayesdrill.basics import PARAMETERS
from studies.paper import printed
from studies.paper.forward import READINGS, MatrixReading
from studies.paper.plots import (
    convergence_figure,
    readings_figure,
    set_decades,
    simultaneous_figure,
    table_3_figure,
    verification_figure,
)
from studies.paper.searches import Heuristic, SearchEnd, Verification

Array = NDArray[np.float64]


SIGMAS = (0.001, 0.01, 0.1, 1.0)


BOUNDS = {"c_m": 0.0072, "k_e": 0.0198}  # at sigma 1, SI


def si(label: str, u: Array) -> Array:
    """What a reader of the axis makes of the numbers u on it."""
    power = re.search(r"\[\$10\^\{(-?\d+)\}", label)
    return u * 10.0 ** (int(power[1]) if power else 0)


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


SCALES = (r"j_m, c_m, k_T, k_s, j_1, t_f", r"k_T, r_m, l_m")


def points(lines: Sequence[Line2D]) -> list[tuple[float, float]]:
    return sorted((float(x), float(y)) for line in lines for x, y in xy(line).T)


@run_cases("ends_at", [(0.7, 9e5), (2e-7, 30.0), (0.004, 2e3), (1e-40, 1e40)])
def test_decades_are_labelled_with_what_they_are(ends_at: tuple[float, float]) -> None:
    panel = Figure().add_subplot()
    set_decades(panel.yaxis, *ends_at)
    drawn(panel.figure)
    low, high = ends_at
    labels = [label.get_text() for label in panel.get_yticklabels()]
    assert 2 <= len(labels) <= 9
    for place, label in zip(panel.get_yticks(), labels, strict=True):
        assert low <= place <= high
        power = re.fullmatch(r"\$10\^\{(0|-?[1-9]\d*)\}\$", label)
        assert place == pytest.approx(10.0 ** int(power[1]) if power else float(label))


def end(way: str, misfit: float, scales: tuple[float, ...], distance: float) -> SearchEnd:
    return SearchEnd(
        way=way,
        misfit=misfit,
        reached=misfit < 1.1,
        best=misfit < 1.0,
        settled=True,
        scales=scales,
        rest=0.1,
        distance=distance,
    )


def ends(n_scales: int) -> tuple[SearchEnd, ...]:
    found = [
        ("fminsearch", 0.98, (-0.1, -0.4), 0.26),
        ("fminsearch", 546.6, (-0.5, -3.1), 1.8),
        ("fminsearch", 1.2, (0.9, 0.3), 0.7),
        ("scaled", 1.02, (-0.9, 1.1), 1.2),
        ("scaled", 8e3, (2.0, -0.3), 1.1),
    ]
    return tuple(end(way, m, s[:n_scales], d) for way, m, s, d in found)


@run_cases("n_scales", [0, 1, 2])
def test_open_marks_are_the_searches_that_did_not_reach_the_noise(n_scales: int) -> None:
    every = ends(n_scales)
    figure = simultaneous_figure(every, SCALES[:n_scales])
    assert not list(clashes(drawn(figure)))
    assert len(figure.axes) == (2 if n_scales else 1)
    right = figure.axes[-1]
    for way, marker in (("fminsearch", "o"), ("scaled", "^")):
        for reached in (True, False):
            chosen = [e for e in every if e.way == way and (e.misfit < 1.1) is reached]
            expected = sorted((e.distance, e.misfit) for e in chosen)
            assert points(marked(right, marker, filled=reached)) == expected
            if n_scales == 2:
                factors = sorted((float(np.exp(e.scales[0])), e.scales[1]) for e in chosen)
                seen = points(marked(figure.axes[0], marker, filled=reached))
                assert [x for x, _ in seen] == pytest.approx([x for x, _ in factors])
                assert np.log([y for _, y in seen]) == pytest.approx([y for _, y in factors])
    assert right.get_ylim()[0] < 1.0
    assert right.get_ylim()[1] > 8e3


@run_cases("n_scales", [1, 2])
def test_the_truth_stands_at_factor_one(n_scales: int) -> None:
    left = simultaneous_figure(ends(n_scales), SCALES[:n_scales]).axes[0]
    ((x, y),) = points(marked(left, "+"))
    assert x == 1.0
    assert n_scales == 1 or y == 1.0
    for line in (line for line in left.get_lines() if line.get_marker() in ("o", "^")):
        low, high = left.get_xlim()
        assert np.all((low <= xy(line)[0]) & (xy(line)[0] <= high))
        assert within(left, xy(line)[1])


def heuristic(**given: Array) -> Heuristic:
    """Of one record, what is not given all ones, and without other starts."""
    ones = np.ones(9)
    found = {"guess": ones, "estimate": ones, "misfits": ones, "others": np.ones((0, 9)), **given}
    others = np.ones(len(found["others"]))
    return Heuristic(**found, others_misfits=others, stepped=ones, stepped_misfit=1.0)


def test_the_misfit_after_each_iteration() -> None:
    paths = [0.98 + 500 * 0.9 ** np.arange(200.0), 0.97 + 3e5 * 0.95 ** np.arange(1379.0)]
    named = list(
        zip(
            ("estimates", "missing_$physics"),
            [heuristic(misfits=path) for path in paths],
            strict=True,
        )
    )
    figure = convergence_figure(named)
    assert not list(clashes(drawn(figure)))
    (panel,) = figure.axes
    steps = [line for line in panel.get_lines() if line.get_drawstyle() == "steps-post"]
    for line, path in zip(steps, paths, strict=True):
        np.testing.assert_array_equal(xy(line), [np.arange(len(path)), path])
        assert within(panel, path)
    assert any(np.all(xy(line)[1] == 1.0) for line in panel.get_lines())


@run_cases(
    "n, known, starts, printed",
    [(9, True, 24, "true"), (9, True, 24, "other"), (13, False, 0, "other"), (2, True, 1, "none")],
)
def test_table_3_shows_each_estimate_over_its_guess(
    n: int, known: bool, starts: int, printed: str
) -> None:
    draws = posterior(4000)[:, :n]
    names = [symbol.name for symbol in SYMBOLS[:n]]
    guess = np.median(draws, axis=0) / np.geomspace(0.6, 1.6, n)
    estimate = guess * np.geomspace(0.2, 3.3, n)
    others = guess * np.random.default_rng(2).uniform(0.3, 3.0, (starts, n))
    truth = np.quantile(draws, 0.7, axis=0) if known else None
    paper = {"true": truth, "other": 1.3 * guess, "none": np.full(n, np.nan)}[printed]
    paper[-1] = np.nan  # not all that is unknown is in the paper
    figure = table_3_figure(
        names, heuristic(guess=guess, estimate=estimate, others=others), truth, draws, paper
    )
    assert not list(clashes(drawn(figure)))
    (panel,) = figure.axes
    crosses = marked(panel, "x")
    assert len(crosses) == (printed == "other")
    if crosses:
        np.testing.assert_allclose(xy(crosses[0])[0], paper / guess)
    np.testing.assert_allclose(xy(*marked(panel, "D"))[0], estimate / guess)
    dots = [xy(line)[0] for line in marked(panel, "o")]
    np.testing.assert_allclose(np.array(dots).reshape(-1, n), others / guess)
    ticks = marked(panel, "|")
    if truth is None:
        assert not ticks
    else:
        np.testing.assert_allclose(xy(ticks[0])[0], truth / guess)
    labels = [label.get_text() for label in panel.get_yticklabels()]
    assert labels[:9] == [f"${symbol.latex}$" for symbol in SYMBOLS[:n][:9]]
    assert len(set(labels)) == n
    low, high = panel.get_xlim()
    assert low < (estimate / guess).min()
    assert (estimate / guess).max() < high


def test_bars_hold_their_share_of_the_draws_the_narrowest_and_the_middle() -> None:
    draws = np.random.default_rng(4).standard_exponential((20_000, 2)) + 1.0
    guess = np.array([1.0, 2.0])
    none = np.ones((0, 2))
    own = heuristic(guess=guess, estimate=guess, others=none)
    figure = table_3_figure(("k_s", "j_1"), own, None, draws, guess)
    for row, ratios in enumerate((draws / guess).T):
        bars = {}
        for line in figure.axes[0].get_lines():
            x, y = xy(line)
            if len(x) == 2 and y[0] == y[1] and round(y[0]) == row and x[0] > 0:
                bars[line.get_linewidth()] = x
        thin, thick = (bars[width] for width in sorted(bars))
        for (low, high), share in ((thin, 0.94), (thick, 0.5)):
            inside = np.mean((low <= ratios) & (ratios <= high))
            assert inside == pytest.approx(share, abs=0.001)
        # Of a density that only falls, the narrowest interval begins where it does.
        assert thin[0] < np.quantile(ratios, 0.02)
        assert np.mean(ratios < thick[0]) == pytest.approx(0.25, abs=0.001)
