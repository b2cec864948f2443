"""The trace as it is rendered: medians of the ensembles, told apart in print, and burn-in."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from support.case_tables import for_each
from support.figure_checks import SYMBOLS, TABLE, clashes, displayed, drawn, mode_of, posterior, si

from bayesdrill.inference.priors import LogUniform
from bayesdrill.report import scales
from bayesdrill.report.sections.convergence_figure import STRETCHES, trace_figure


def theta_of(width: float | None = None, n: int = 9) -> np.ndarray:
    return posterior(3 * 500 * 12, width)[:, :n].reshape(3, 500, 12, n)


def case(
    width: float | None = None,
    n: int = 9,
    inches: float = scales.DOUBLE,
    logs: tuple[str, ...] = (),
) -> Figure:
    theta = theta_of(width, n)
    mode = mode_of(theta.reshape(-1, n), SYMBOLS[:n])
    priors = {name: LogUniform(1e-9, 1e9) for name in logs}
    shown = displayed(SYMBOLS[:n], TABLE, mode, priors)
    return drawn(trace_figure(theta, shown, 70, inches))


@pytest.mark.parametrize("inches", [scales.SINGLE, scales.DOUBLE])
@pytest.mark.parametrize(
    ("n", "width"),
    [
        *((1, None), (3, None), (9, None), (9, 1e-5)),
        pytest.param(13, None, marks=pytest.mark.slow),
    ],
)
def test_no_texts_overlap(n: int, width: float | None, inches: float) -> None:
    figure = case(width, n, inches, ("c_m", "l_m"))
    assert list(clashes(figure)) == []
    assert figure.get_figwidth() <= inches


def medians(figure: Figure, panel: int) -> list[Line2D]:
    lines = figure.axes[panel].get_lines()
    return [c for c in lines if len(c.get_xdata()) > 2 and c.get_linestyle() != "None"]


def test_it_shows_the_medians_of_stretches_and_says_burn_in_once() -> None:
    def check(log: bool) -> None:
        figure, theta = case(logs=("r_m",) if log else ()), theta_of()
        label = figure.axes[4].get_ylabel()
        assert len(medians(figure, 4)) == 3
        for ensemble, median in enumerate(medians(figure, 4)):
            places = np.asarray(median.get_xdata())
            assert len(places) <= STRETCHES
            assert places[0] < 10
            assert places[-1] > 490
            shown = np.asarray(median.get_ydata())
            got = [si(label, 10.0**u if log else u) for u in shown]
            course = np.median(theta[ensemble, :, :, 4], axis=1)
            around = [course[np.abs(np.arange(500) - place) <= 6] for place in places]
            for value, near in zip(got, around, strict=True):
                assert near.min() <= value <= near.max()
        (legend,) = figure.legends
        texts = [text.get_text() for text in legend.get_texts()]
        assert texts.count("burn-in: 70 steps dropped") == 1

    for_each({str(log): (log,) for log in [True, False]}, check)


def grey(line: Line2D) -> float:
    return float(np.mean(to_rgb(line.get_color())))


def dash(line: Line2D) -> tuple[float, ...]:
    return tuple(line._unscaled_dash_pattern[1] or ())


def test_four_ensembles_are_apart_in_print_and_numbered() -> None:
    """Mutants killed: looks that differ by a grey of a tenth alone; numbers at one place."""
    theta = np.concatenate([theta_of(), theta_of()[:1]])
    figure = drawn(trace_figure(theta, displayed(SYMBOLS[:9], TABLE, {}, {}), 70))
    for a, b in itertools.combinations(medians(figure, 0), 2):
        assert dash(a) != dash(b) or abs(grey(a) - grey(b)) > 0.4
    marks = {
        c.get_marker(): c for c in figure.axes[0].get_lines() if str(c.get_marker()).startswith("$")
    }
    assert set(marks) == {"$1$", "$2$", "$3$", "$4$"}
    places = [float(line.get_xdata()[0]) for line in marks.values()]
    assert min(np.diff(sorted(places))) > 50
    for (number, mark), median in zip(marks.items(), medians(figure, 0), strict=True):
        at = np.argmin(np.abs(np.asarray(median.get_xdata()) - mark.get_xdata()[0]))
        assert mark.get_ydata()[0] == median.get_ydata()[at], number
