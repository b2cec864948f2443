"""What is said and drawn of several runs or models: sections, a table, figures; what a ladder
recommends.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from bayesdrill.analysis import comparison
from bayesdrill.analysis.comparison import Contender, Decision, Layer, Row, decide
from bayesdrill.inference.display_units import OwnUnits
from bayesdrill.report.section import Picture, Section, as_markdown, as_text
from bayesdrill.report.sections import comparison_words
from bayesdrill.report.view import Drawing
from bayesdrill.selection import Rung

SAYS = (
    "Of each model the log odds against the most probable, what its fit leaves of each channel, and "
    "where it has each unknown."
)
FIGURE = "comparison"
COMPARISON_TABLE, COMPARISON_PAGE = "comparison.csv", "comparison.md"


@dataclass(frozen=True)
class ComparisonReport:
    """Of two `models` or more; `units`: in which people are shown unknowns; `heading`: of pages."""

    models: tuple[Contender, ...]
    units: OwnUnits
    heading: str = ""

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """SI."""
        return comparison.overlay_rows([one.layer for one in self.models])

    @cached_property
    def decision(self) -> Decision:
        return decide(self.models)

    @property
    def best(self) -> Contender:
        return self.models[self.decision.best]

    @property
    def title(self) -> str:
        return self.heading or " against ".join(one.name for one in self.models)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the most probable must not be believed; empty where it may be."""
        return tuple(f"{self.best.name}: {reason}" for reason in self.best.layer.reasons)

    @property
    def sections(self) -> tuple[Section, ...]:
        """With the figure, which a page shows and a terminal does not."""
        pictures = [Picture(name, drawing.says) for name, drawing in self.figures.items()]
        return comparison_words.comparison_sections(self.models, self.rows, self.units, pictures)

    @cached_property
    def figures(self) -> Mapping[str, Drawing]:
        from bayesdrill.report.sections.comparison_figure import comparison_figure

        return {FIGURE: Drawing(comparison_figure, (self.models, self.rows, self.units), says=SAYS)}

    @property
    def texts(self) -> Mapping[str, str]:
        """Files by name."""
        return {
            COMPARISON_TABLE: comparison_words.comparison_csv(self.models, self.rows),
            COMPARISON_PAGE: as_markdown(self.title, self.sections),
        }

    def page(self, figures: Path) -> str:
        """HTML, with the pictures that stand in `figures`."""
        # Late: templates are for this page alone.
        from bayesdrill.report.render import as_html

        symbols = [row.symbol for row in self.rows]
        return as_html(self.title, "comparison", self.sections, figures, symbols)

    @property
    def text(self) -> str:
        """For a terminal."""
        return "\n\n".join(as_text(self.sections))


def ladder_opening(every: Sequence[Rung], missing: int) -> str:
    """What is to be run."""
    if not every:
        return "nothing more to try"
    done = f" ({len(every) - missing} of them done before)" if missing < len(every) else ""
    return "\n".join(
        [f"to try{done}:", *(f"  {one.name}: {one.about}" for one in every)],
    )


def ladder_conclusion(chosen: Rung, left_out: Mapping[str, str], config: Path) -> str:
    """What was not tried, and what to go on with."""
    return "\n".join([*_left_out(left_out), f"recommended: {chosen.about}: {config}"])


def _left_out(left_out: Mapping[str, str]) -> Iterator[str]:
    for name, reason in left_out.items():
        yield f"left out: {name}: {reason}"


def about_config(chosen: Rung, name: str, report: ComparisonReport) -> str:
    """For the head of the config."""
    verdict = next(iter(comparison_words.comparison_verdict(report.models)))
    simplest = "the simplest of the models that are about as probable as the best"
    return f"{name}: {chosen.about}, {simplest}.\n{verdict}"


INTERVALS = "Where each run has each unknown: mean, interval and nominal value."
CORNER = "The posteriors of all runs over each other, for each unknown and each pair (corner plot)."
OVERLAY_TABLE, OVERLAY_PAGE = "overlay.csv", "overlay.md"


@dataclass(frozen=True)
class OverlayReport:
    """Of two `layers` or more; `units`: in which people are shown their unknowns."""

    layers: tuple[Layer, ...]
    units: OwnUnits

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """SI."""
        return comparison.overlay_rows(self.layers)

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
        return comparison_words.overlay_sections(self.layers, self.rows, self.units, self.pictures)

    @property
    def pictures(self) -> tuple[Picture, ...]:
        return tuple(Picture(name, drawing.says) for name, drawing in self.figures.items())

    @cached_property
    def figures(self) -> Mapping[str, Drawing]:
        """By name; no corner where no two runs share an unknown."""
        from bayesdrill.report.sections.overlay_figure import (
            intervals_figure,
            overlay_corner_figure,
        )

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
            OVERLAY_TABLE: comparison_words.overlay_csv(self.layers, self.rows),
            OVERLAY_PAGE: as_markdown(self.title, self.sections),
        }

    def page(self, figures: Path) -> str:
        """HTML, with the pictures that stand in `figures`."""
        # Late: templates are for this page alone.
        from bayesdrill.report.render import as_html

        symbols = [row.symbol for row in self.rows]
        return as_html(self.title, "overlay", self.sections, figures, symbols)

    @property
    def text(self) -> str:
        """For a terminal."""
        return "\n\n".join(as_text(self.sections))
