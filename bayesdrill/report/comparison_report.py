"""What is said and drawn of several models of one record: sections, a table, a figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from bayesdrill.insight import overlay
from bayesdrill.insight.comparison import Contender, Decision, decide
from bayesdrill.insight.overlay import Row
from bayesdrill.report import comparison_words
from bayesdrill.report.sections import Picture, Section, as_markdown, as_text
from bayesdrill.report.view import Drawing
from bayesdrill.setup.own_units import OwnUnits

SAYS = (
    "Of each model the log odds against the most probable, what its fit leaves of each channel, and "
    "where it has each unknown."
)
FIGURE = "comparison"
TABLE, PAGE = "comparison.csv", "comparison.md"


@dataclass(frozen=True)
class ComparisonReport:
    """Of two `models` or more; `units`: in which people are shown unknowns; `heading`: of pages."""

    models: tuple[Contender, ...]
    units: OwnUnits
    heading: str = ""

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """SI."""
        return overlay.rows([one.layer for one in self.models])

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
        return comparison_words.sections(self.models, self.rows, self.units, pictures)

    @cached_property
    def figures(self) -> Mapping[str, Drawing]:
        from bayesdrill.report.comparison_plot import comparison_figure  # late: matplotlib

        return {FIGURE: Drawing(comparison_figure, (self.models, self.rows, self.units), says=SAYS)}

    @property
    def texts(self) -> Mapping[str, str]:
        """Files by name."""
        return {
            TABLE: comparison_words.as_csv(self.models, self.rows),
            PAGE: as_markdown(self.title, self.sections),
        }

    def page(self, figures: Path) -> str:
        """HTML, with the pictures that stand in `figures`."""
        # Late: templates are for this page alone.
        from bayesdrill.report.html import as_html

        symbols = [row.symbol for row in self.rows]
        return as_html(self.title, "comparison", self.sections, figures, symbols)

    @property
    def text(self) -> str:
        """For a terminal."""
        return "\n\n".join(as_text(self.sections))
