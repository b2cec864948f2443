"""The corner plot: places of draws, contours, nominal values and the MAP; logarithmic axes."""

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.patches import StepPatch
from support import figure_contexts as contexts
from support.case_tables import for_each
from support.figure_checks import SYMBOLS, TABLE, corner_panels, displayed, mode_of, posterior, si

from bayesdrill.inference.priors import Uniform
from bayesdrill.report import style
from bayesdrill.report.sections.corner import corner_figure

NINE = tuple(range(9))
PAIR = (SYMBOLS[0], SYMBOLS[6])  # j_m and k_s


def histogram(panel: Axes) -> tuple[np.ndarray, np.ndarray]:
    (steps,) = (p for p in panel.patches if isinstance(p, StepPatch))
    counts, edges, _ = steps.get_data()
    return counts, edges


def line(panel: Axes, colour: object, *, upright: bool) -> float:
    """Where the first dashed line of this colour crosses the panel."""
    for candidate in panel.get_lines():
        x, y = (np.asarray(data, dtype=float) for data in candidate.get_data())
        along, across = (y, x) if upright else (x, y)
        visible = candidate.get_linestyle() != "None" and candidate.is_dashed()
        if visible and candidate.get_color() == colour and list(along) == [0, 1]:
            return float(across[0])
    raise AssertionError(f"no line of {colour}")


def test_nominal_values_and_the_map_are_at_their_places() -> None:
    def check(columns: tuple[int, ...], width: float | None) -> None:
        figure, symbols = contexts.corner(columns, width=width), [SYMBOLS[k] for k in columns]
        mode = mode_of(posterior(1500, width)[:, columns], tuple(symbols))
        labels = [panel.get_xlabel() for panel in figure.axes[-len(columns) :]]
        for (i, j), panel in corner_panels(figure).items():
            x, y = symbols[j].name, symbols[i].name
            nominal = style.NOMINAL["color"]
            places = [(j, line(panel, nominal, upright=True), TABLE[x])]
            if i == j:
                places += [(j, line(panel, style.MAP_COLOUR, upright=True), mode[x])]
            else:
                (cross,) = (c for c in panel.get_lines() if c.get_marker() == "+")
                places += [
                    (i, line(panel, nominal, upright=False), TABLE[y]),
                    (j, cross.get_xdata()[0], mode[x]),
                    (i, cross.get_ydata()[0], mode[y]),
                ]
            for k, place, expected in places:
                assert si(labels[k], place) == pytest.approx(expected, rel=1e-9)

    cases = {"1": ((1,), None), "2": ((0, 6), None), "9": (NINE, None), "narrow": ((0, 3, 6), 1e-5)}
    for_each(cases, check)


def test_a_flat_density_has_no_contour_and_a_histogram_ends_where_its_prior_does() -> None:
    rng = np.random.default_rng(5)
    n = 12_000
    low, high = (np.array([TABLE[s.name] for s in PAIR]) * share for share in (0.5, 1.5))
    priors = {s.name: Uniform(a, b) for s, a, b in zip(PAIR, low, high, strict=True)}
    for flat in (True, False):
        share = rng.uniform(size=(n, 2)) if flat else rng.beta(4, 4, (n, 2))
        figure = corner_figure(low + (high - low) * share, displayed(PAIR, TABLE, {}, priors))
        panels = corner_panels(figure)
        lines = [c for c in panels[1, 0].collections if not c.filled and len(c.get_paths()) > 1]
        assert bool(lines) != flat
        counts, edges = histogram(panels[0, 0])
        assert counts.sum() == n
        first, last = (si(panels[1, 0].get_xlabel(), edge) for edge in edges[[0, -1]])
        assert low[0] * (1 - 1e-9) <= first < last <= high[0] * (1 + 1e-9)
        if flat:
            assert counts[[0, -1]].min() > 0.7 * np.median(counts)


def test_panels_that_are_too_small_for_numbers_have_the_ends_of_their_axes_in_turned_labels() -> (
    None
):
    columns = [0, 3, 6]
    symbols, draws = [SYMBOLS[k] for k in columns], posterior(300)[:, columns]
    figure = corner_figure(draws, displayed(symbols, {}, {}, {}), 0.6)
    panels = corner_panels(figure)
    for k, x in enumerate(draws.T):
        panel = panels[2, k]
        assert not any(text.get_text() for text in panel.get_xticklabels())
        label, ends = panel.get_xlabel().split("\n")
        low, high = (si(label, float(end)) for end in ends.split(" to "))
        assert low < np.quantile(x, 0.1) < np.quantile(x, 0.9) < high
        assert panel.xaxis.label.get_rotation() == 90
    assert panels[1, 0].get_ylabel() == f"${symbols[1].latex}$"
