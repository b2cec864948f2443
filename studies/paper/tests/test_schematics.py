"""The drawing of the pairwise search as it is rendered."""

import itertools
import re
from functools import cache

import numpy as np
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Polygon, Rectangle
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from numpy.typing import NDArray
from support.figure_checks import box, drawn, overlap, shown

from bayesdrill.basics import PARAMETERS
from studies.paper.optimisers import ORDER, circle
from studies.paper.schematics import heuristic_figure

PAIRS = circle(ORDER)


@cache
def picture() -> Figure:
    return drawn(heuristic_figure(PAIRS, 10))


def texts(figure: Figure) -> list[Text]:
    return shown(list(figure.axes[0].texts))


def corners(arrow: FancyArrowPatch) -> NDArray[np.float64]:
    """Of the line and its head; the first is where the arrow starts."""
    path = arrow.get_path()
    vertices: NDArray[np.float64] = np.asarray(path.vertices, dtype=np.float64)
    kept: NDArray[np.float64] = vertices[np.asarray(path.codes) != Path.CLOSEPOLY]
    return kept


def names(text: Text) -> list[str]:
    found = re.findall(r"(?<![\\\w])[a-z]_\w", text.get_text())
    return [name for name in found if name in PARAMETERS]


def steps(figure: Figure) -> list[Rectangle]:
    """The boxes of the search, there along the upper row and back along the lower one."""
    boxes = [p for p in figure.axes[0].patches if isinstance(p, Rectangle) and p.get_height() > 0.5]
    top = max(p.get_y() for p in boxes)
    return sorted(
        boxes, key=lambda p: (p.get_y() < top, p.get_x() * (1 if p.get_y() == top else -1))
    )


def inside(outer: Rectangle, inner: Bbox) -> bool:
    area = outer.get_window_extent()
    return bool(area.contains(*inner.p0) and area.contains(*inner.p1))


def test_texts_are_apart_and_inside_the_page() -> None:
    figure = picture()
    every = [(text.get_text(), box(text)) for text in texts(figure)]
    for (text, a), (other, b) in itertools.combinations(every, 2):
        assert not overlap(a, b), f"{text} on {other}"
    assert all(figure.bbox.contains(*a.p0) and figure.bbox.contains(*a.p1) for _, a in every)


def test_each_pair_has_a_box_and_its_two_cells_are_dark() -> None:
    figure = picture()
    boxes = steps(figure)
    assert len(boxes) == len(PAIRS)
    lowest = [text for text in texts(figure) if text.get_position()[1] < 0.5 and names(text)]
    order = [names(text)[0] for text in sorted(lowest, key=lambda text: text.get_position()[0])]
    assert sorted(order) == sorted(ORDER)
    words = [(text, box(text)) for text in texts(figure)]
    cells = [p for p in figure.axes[0].patches if isinstance(p, Rectangle) and p not in boxes]
    places = [p.get_window_extent() for p in cells]
    for pair, outer in zip(PAIRS, boxes, strict=True):
        own = [text for text, place in words if inside(outer, place)]
        assert [found for text in own for found in names(text)] == list(pair)
        assert any("10 iterations" in text.get_text() for text in own)
        strip = [p for p, place in zip(cells, places, strict=True) if inside(outer, place)]
        strip.sort(key=lambda p: p.get_x())
        dark = [to_hex(p.get_facecolor()) != to_hex("white") for p in strip]
        assert {name for name, full in zip(order, dark, strict=True) if full} == set(pair)


def test_arrows_lead_through_all_pairs_to_the_decision_and_back() -> None:
    figure = picture()
    (decision,) = (p for p in figure.axes[0].patches if isinstance(p, Polygon))
    nodes = [p.get_window_extent().padded(12) for p in (*steps(figure), decision)]
    edges = set()
    for arrow in (p for p in figure.axes[0].patches if isinstance(p, FancyArrowPatch)):
        path = figure.axes[0].transData.transform(corners(arrow))
        touched = [{k for k, node in enumerate(nodes) if node.contains(*v)} for v in path]
        edges |= set(itertools.product(touched[0], set().union(*touched) - touched[0]))
    n = len(nodes)
    assert edges == {(k, (k + 1) % n) for k in range(n)}


def test_an_arrow_says_what_the_next_search_starts_from() -> None:
    figure = picture()
    outside = [
        text
        for text in texts(figure)
        if text.get_position()[1] > 0.5 and not any(inside(b, box(text)) for b in steps(figure))
    ]
    assert sorted(found for text in outside for found in names(text)) == sorted(ORDER)
