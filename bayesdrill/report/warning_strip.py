"""What a figure must say before anything else: in a strip of its own, on the page itself."""

from __future__ import annotations

import textwrap

from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.transforms import Affine2D

from bayesdrill.report.style import styled

MARGIN, LINE, LETTER = 0.09, 0.16, 0.066  # inches: of the strip, a line of it, a letter of that


def warned(figure: Figure, warning: str) -> Figure:
    """The figure, with `warning` above what it shows; it is no part of what a window or a file cuts.

    The page grows at its top, and nothing else changes its size.
    """
    if not warning:
        return figure
    width, height = (float(inches) for inches in figure.get_size_inches())
    lines = textwrap.wrap(warning, max(8, int((width - 2 * MARGIN) / LETTER)))
    strip = 2 * MARGIN + LINE * len(lines)
    _lower(figure, height + strip, height / (height + strip))
    with styled():
        figure.text(
            0.5,
            1.0 - 0.5 * strip / (height + strip),
            "\n".join(lines),
            ha="center",
            va="center",
            weight="bold",
            size=9.0,
            linespacing=1.1,
        )
    return figure


def _lower(figure: Figure, height: float, share: float) -> None:
    """To a page of this height, of which all that is there takes the lower `share`."""
    anchors = [
        (legend, legend.get_bbox_to_anchor().transformed(figure.transFigure.inverted()))
        for legend in figure.get_children()
        if isinstance(legend, Legend)
    ]
    engine = figure.get_layout_engine()
    figure.set_size_inches(float(figure.get_figwidth()), height)
    if engine is not None:
        engine.set(rect=(0, 0, 1, share))  # type: ignore[call-arg]
    for panel in figure.axes:
        x, y, w, h = panel.get_position(original=True).bounds
        panel.set_position((x, y * share, w, h * share))
    for legend, box in anchors:
        lowered = (box.x0, box.y0 * share, box.width, box.height * share)
        legend.set_bbox_to_anchor(lowered, transform=figure.transFigure)
    down = Affine2D().scale(1.0, share) + figure.transFigure
    own: list[Artist] = [*figure.artists, *figure.lines, *figure.patches, *figure.texts]
    for artist in own:
        if not isinstance(artist, Legend):
            artist.set_transform(down)
