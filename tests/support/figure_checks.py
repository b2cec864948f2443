"""Draws that are hard to picture, what overlaps in a picture, and where its points are."""

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from bayesdrill.basics.symbols import NOMINAL, PARAMETERS, Symbol, noise_symbol
from bayesdrill.inference.display_units import DisplayedUnknowns
from bayesdrill.inference.priors import HalfNormal, Prior, Uniform

Array = NDArray[np.float64]

TABLE = dict(NOMINAL["tables_2_3"])
SIGMAS = {"w_1": 0.31, "w_2": 0.052, "i": 0.0123, "theta_1": 4.4e-3}
SYMBOLS = (
    *(PARAMETERS[name] for name in TABLE),
    noise_symbol("w_1", "rad/s", r"\dot\theta_1", "rad/s"),
    noise_symbol("w_2", "rad/s", r"\dot\theta_2", "rad/s"),
    noise_symbol("i", "A", r"\dot q", "A"),
    noise_symbol("theta_1", "rad", r"\theta_1", "rad"),
)


def posterior(n: int, width: float | None = None) -> Array:
    """`(n, 13)` SI: skewed, correlated, one that is just its prior; or all of relative `width`."""
    rng = np.random.default_rng(5)
    z = rng.standard_normal((n, 13))
    ratio = 1 + 0.03 * z
    common = 0.08 * z[:, 6]
    for column, mean in ((0, 1.02), (6, 1.05), (7, 1.03)):
        ratio[:, column] = mean + common + 8e-4 * z[:, column]
    ratio[:, 1] = 0.6 + 0.2 * rng.gamma(2.0, 0.6, n)
    ratio[:, 3] = 0.97 - 0.3 * (ratio[:, 2] - 1) + 0.005 * z[:, 3]
    ratio[:, 5] = rng.uniform(0.5, 1.5, n)
    if width is not None:
        ratio = 1 + width * (3 + (ratio - ratio.mean(0)) / ratio.std(0))
    return ratio * np.array([*TABLE.values(), *SIGMAS.values()])


def prior_of(symbol: Symbol) -> Prior:
    if symbol.name in TABLE:
        return Uniform(0.5 * TABLE[symbol.name], 1.5 * TABLE[symbol.name])
    return HalfNormal(2 * SIGMAS[symbol.name.removeprefix("sigma_")])


def mode_of(draws: Array, symbols: tuple[Symbol, ...]) -> dict[str, float]:
    return {s.name: float(np.quantile(draws[:, d], 0.4)) for d, s in enumerate(symbols)}


def displayed(
    symbols: Sequence[Symbol],
    nominal: Mapping[str, float],
    mode: Mapping[str, float],
    priors: Mapping[str, Prior],
) -> DisplayedUnknowns:
    """In SI."""
    return DisplayedUnknowns(symbols=tuple(symbols), nominal=nominal, mode=mode, priors=priors)


def drawn(figure: Figure) -> Figure:
    FigureCanvasAgg(figure).draw()
    return figure


def shown(texts: list[Text]) -> list[Text]:
    return [text for text in texts if text.get_visible() and text.get_text()]


def box(text: Text) -> Bbox:
    return text.get_window_extent()


def overlap(a: Bbox, b: Bbox) -> bool:
    """By more than half a pixel."""
    return bool(np.all(np.minimum(a.p1, b.p1) - np.maximum(a.p0, b.p0) > 0.5))


def overlapping(boxes: list[Bbox]) -> Iterator[tuple[int, int]]:
    """Pairs of them, see `overlap`: all at once, as there are thousands."""
    ends = np.array([(a.p0, a.p1) for a in boxes]).reshape(-1, 2, 2)
    least, most = ends[:, 0], ends[:, 1]
    common = np.minimum(most[:, None], most) - np.maximum(least[:, None], least)
    for one, other in zip(*np.nonzero(np.triu((common > 0.5).all(axis=-1), 1)), strict=True):
        yield int(one), int(other)


def clashes(figure: Figure) -> Iterator[str]:
    """Pairs of texts that overlap, texts that leave the page, and words of the page on a panel."""
    panels = [panel for panel in figure.axes if panel.axison]
    labels = [
        text
        for panel in panels
        for text in (
            *(panel.xaxis.label, panel.yaxis.label, panel.title, panel._left_title),
            *(*panel.get_xticklabels(), *panel.get_yticklabels(), *panel.texts),
        )
    ]
    own = [legend for panel in figure.axes if (legend := panel.get_legend()) is not None]
    labels += [text for legend in own for text in legend.get_texts()]
    words = shown([*(t for legend in figure.legends for t in legend.get_texts()), *figure.texts])
    boxes = [(text.get_text(), box(text)) for text in (*shown(labels), *words)]
    for text in words:
        if any(overlap(box(text), panel.get_window_extent()) for panel in panels):
            yield f"{text.get_text()} on a panel"
    for one, other in overlapping([a for _, a in boxes]):
        yield f"{boxes[one][0]} on {boxes[other][0]}"
    page = figure.bbox.padded(0.5)
    for text, a in boxes:
        if not (page.contains(*a.p0) and page.contains(*a.p1)):
            yield f"{text} leaves the page"


def legend_texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def xy(line: Line2D) -> Array:
    return np.array(line.get_data(), dtype=float)


def marked(panel: Axes, marker: str, *, filled: bool | None = None) -> list[Line2D]:
    """Return the lines with this marker; only those with filled or open ones if `filled` is given."""
    lines = [line for line in panel.get_lines() if line.get_marker() == marker]
    if filled is None:
        return lines
    return [line for line in lines if (line.get_markerfacecolor() != "none") is filled]


def within(panel: Axes, y: Array) -> bool:
    """Return whether all of `y` is between the ends of the vertical axis."""
    low, high = panel.get_ylim()
    return bool(low <= y.min() and y.max() <= high)


def si(label: str, u: float) -> float:
    """What a reader of the axis makes of the number u on it: only the label is known."""
    quantity, inside = label.replace("\n", " ").split(" [")
    power = re.match(r"\$10\^\{(-?\d+)\}", inside)
    origin = re.search(r" - ([\d.]+)(?:\{\\cdot\}10\^\{(-?\d+)\})?\$", quantity)
    start = float(f"{origin[1]}e{origin[2] or 0}") if origin else 0.0
    return start + u * 10.0 ** (int(power[1]) if power else 0)


def corner_panels(figure: Figure) -> dict[tuple[int, int], Axes]:
    """The panels of a corner plot by row and column."""
    n = max(panel.get_subplotspec().rowspan.start for panel in figure.axes) + 1
    assert len(figure.axes) == n * (n + 1) // 2
    return {
        (spec.rowspan.start, spec.colspan.start): panel
        for panel in figure.axes
        for spec in [panel.get_subplotspec()]
    }
