"""What is said and drawn of several runs together: sections, a table, figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from bayesdrill.insight import overlay
from bayesdrill.insight.overlay import Layer, Row
from bayesdrill.report import overlay_words
from bayesdrill.report.sections import Picture, Section, as_markdown, as_text
from bayesdrill.report.view import Drawing
from bayesdrill.setup.own_units import OwnUnits

INTERVALS = "Where each run has each unknown: mean, interval and nominal value."
CORNER = "The posteriors of all runs over each other, for each unknown and each pair (corner plot)."
TABLE, PAGE = "overlay.csv", "overlay.md"


@dataclass(frozen=True)
class OverlayReport:
    """Of two `layers` or more; `units`: in which people are shown their unknowns."""

    layers: tuple[Layer, ...]
    units: OwnUnits

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """SI."""
        return overlay.rows(self.layers)

    @property
    def title(self) -> str:
        return " beside ".join(layer.name for layer in self.layers)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why some of it must not be believed; empty where all of it may be."""
        return tuple(f"{one.name}: {reason}" for one in self.layers for reason in one.reasons)

    @property
    def sections(self) -> tuple[Section, ...]:
        """With the figures, which a page shows and a terminal does not."""
        return overlay_words.sections(self.layers, self.rows, self.units, self.pictures)

    @property
    def pictures(self) -> tuple[Picture, ...]:
        return tuple(Picture(name, drawing.says) for name, drawing in self.figures.items())

    @cached_property
    def figures(self) -> Mapping[str, Drawing]:
        """By name; no corner where no two runs share an unknown."""
        from bayesdrill.report.intervals_plot import intervals_figure
        from bayesdrill.report.overlay_corner_plot import overlay_corner_figure

        given = (self.layers, self.rows, self.units)
        found = {}
        if self.rows:
            found["intervals"] = Drawing(intervals_figure, given, says=INTERVALS)
        if any(row.shared for row in self.rows):
            found["corner"] = Drawing(overlay_corner_figure, given, says=CORNER)
        return found

    @property
    def texts(self) -> Mapping[str, str]:
        """Files by name."""
        return {
            TABLE: overlay_words.as_csv(self.layers, self.rows),
            PAGE: as_markdown(self.title, self.sections),
        }

    def page(self, figures: Path) -> str:
        """HTML, with the pictures that stand in `figures`."""
        # Late: templates are for this page alone.
        from bayesdrill.report.html import as_html

        symbols = [row.symbol for row in self.rows]
        return as_html(self.title, "overlay", self.sections, figures, symbols)

    @property
    def text(self) -> str:
        """For a terminal."""
        return "\n\n".join(as_text(self.sections))
