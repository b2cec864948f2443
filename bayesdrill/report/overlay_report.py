"""What is said and drawn of several runs together: sections, a table, figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from bayesdrill.insight import overlay
from bayesdrill.insight.overlay import Layer, Row
from bayesdrill.report import overlay_words
from bayesdrill.report.sections import Section, as_markdown, as_text
from bayesdrill.report.view import Drawing

TABLE, PAGE = "overlay.csv", "overlay.md"


@dataclass(frozen=True)
class OverlayReport:
    """Of two `layers` or more."""

    layers: tuple[Layer, ...]

    @cached_property
    def rows(self) -> tuple[Row, ...]:
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
        return overlay_words.sections(self.layers, self.rows)

    @property
    def figures(self) -> Mapping[str, Drawing]:
        """By name; no corner where no two runs share an unknown."""
        from bayesdrill.report.intervals_plot import intervals_figure
        from bayesdrill.report.overlay_corner_plot import overlay_corner_figure

        given = (self.layers, self.rows)
        found = {"intervals": Drawing(intervals_figure, given)} if self.rows else {}
        if any(row.shared for row in self.rows):
            found["corner"] = Drawing(overlay_corner_figure, given)
        return found

    @property
    def texts(self) -> Mapping[str, str]:
        """Files by name."""
        return {
            TABLE: overlay_words.as_csv(self.layers, self.rows),
            PAGE: as_markdown(self.title, self.sections),
        }

    @property
    def text(self) -> str:
        """For a terminal."""
        return "\n\n".join(as_text(self.sections))
