"""Report several runs, overlaid or compared as models of one record; describe ladders of models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from bayesdrill.analysis import comparison
from bayesdrill.analysis.causes import Causes
from bayesdrill.analysis.comparison import (
    ModelDecision,
    OverlayRow,
    PosteriorSummary,
    RunSummary,
    decide,
)
from bayesdrill.basics.errors import count_noun
from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.output_files import COMPARE, OVERLAY, Kind
from bayesdrill.report.render import as_html
from bayesdrill.report.section import Picture, Section, as_markdown, as_text
from bayesdrill.report.sections.causes import doubt
from bayesdrill.report.sections.comparison import (
    comparison_csv,
    comparison_figure,
    comparison_sections,
    comparison_verdict,
)
from bayesdrill.report.sections.overlay import intervals_figure, overlay_corner_figure, overlay_csv
from bayesdrill.report.view import Drawing

RANKED = 10  # largest number of candidates that are shown
MODELS = (
    "For each model the log odds against the most probable one, the residuals of each channel, and "
    "the estimate of each unknown."
)
INTERVALS = "The estimate of each unknown in each run: mean, interval and nominal value."
CORNER = "The overlaid posteriors of all runs, for each unknown and each pair (corner plot)."


@dataclass(frozen=True, slots=True, kw_only=True)
class Form:
    """The form sets the file names of a comparison, and `max_runs`, the largest number of runs.

    The files of table and page have the stem `name`, and `figure` is shown by default.
    """

    name: str
    kind: Kind
    figure: str
    max_runs: int
    purpose: str  # what happens to the runs, as a participle for messages
    separator: str  # separates names of runs in a heading
    prefix: str = ""  # prefix of the folder's name


OVERLAID = Form(
    name="overlay",
    kind=OVERLAY,
    figure="corner",
    max_runs=6,  # more runs cannot be distinguished in grey
    purpose="laid over each other",
    separator=" beside ",
)
COMPARED = Form(
    name="comparison",
    kind=COMPARE,
    figure="comparison",
    max_runs=24,
    purpose="compared",
    separator=" against ",
    prefix="compare-",
)


@dataclass(frozen=True)
class ComparisonReport:
    """The report shows `layers`, posteriors of runs, and compares them as `models` of one record.

    If `models` is empty, the runs are overlaid. Values are in `units`; `heading` titles the page.
    """

    layers: tuple[PosteriorSummary, ...]
    units: DisplayUnits
    models: tuple[RunSummary, ...] = ()
    heading: str = ""

    @classmethod
    def of_models(cls, models: Sequence[RunSummary], units: DisplayUnits) -> ComparisonReport:
        """Build the report of several models of one record."""
        return cls(tuple(model.layer for model in models), units, tuple(models))

    @property
    def form(self) -> Form:
        """Return the form of the report: models of one record are compared, other runs are overlaid."""
        return COMPARED if self.models else OVERLAID

    @cached_property
    def rows(self) -> tuple[OverlayRow, ...]:
        """Return the rows of all unknowns, in SI units."""
        return comparison.overlay_rows(self.layers)

    @cached_property
    def decision(self) -> ModelDecision | None:
        """Return the decision between models, or None if the runs are not models of one record."""
        return decide(self.models) if self.models else None

    @property
    def best(self) -> RunSummary | None:
        """Return the most probable model, or None if the runs are not models of one record."""
        return None if self.decision is None else self.models[self.decision.best]

    @property
    def title(self) -> str:
        """Return the title of the report."""
        return self.heading or self.form.separator.join(layer.name for layer in self.layers)

    @property
    def mark(self) -> str:
        """Return the marks that identify the runs, for the metadata of figures."""
        return " ".join(layer.mark for layer in self.layers)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return reasons not to believe the report, or none.

        If the runs are models, only the reasons against the most probable model count.
        """
        layers = self.layers if self.best is None else (self.best.layer,)
        return tuple(f"{layer.name}: {reason}" for layer in layers for reason in layer.reasons)

    @cached_property
    def sections(self) -> tuple[Section, ...]:
        """Return the sections, including the figures, which a terminal does not show."""
        pictures = [Picture(name, drawing.says) for name, drawing in self.figures.items()]
        return comparison_sections(self.layers, self.models, self.rows, self.units, pictures)

    @cached_property
    def figures(self) -> Mapping[str, Drawing]:
        """Return the figures by name, without a corner plot if no two runs share an unknown."""
        if self.models:
            given = (self.models, self.rows, self.units)
            return {COMPARED.figure: Drawing(comparison_figure, given, says=MODELS)}
        drawn, drawings = (self.layers, self.rows, self.units), {}
        if self.rows:
            drawings["intervals"] = Drawing(intervals_figure, drawn, says=INTERVALS)
        if any(row.shared for row in self.rows):
            drawings[OVERLAID.figure] = Drawing(overlay_corner_figure, drawn, says=CORNER)
        return drawings

    @property
    def table(self) -> str:
        """Return the table as CSV."""
        if self.models:
            return comparison_csv(self.models, self.rows)
        return overlay_csv(self.layers, self.rows)

    @property
    def texts(self) -> Mapping[str, str]:
        """Return the contents of the text files by name."""
        name, page = self.form.name, as_markdown(self.title, self.sections)
        return {f"{name}.csv": self.table, f"{name}.md": page}

    def page(self, figures: Path) -> str:
        """Return the page as HTML, with the pictures from the folder `figures`."""
        symbols = [row.symbol for row in self.rows]
        return as_html(self.title, self.form.name, self.sections, figures, symbols)

    @property
    def text(self) -> str:
        """Return the report for a terminal."""
        return "\n\n".join(as_text(self.sections))


def ranking(causes: Causes, seconds: Mapping[tuple[str, ...], float]) -> str:
    """Describe the ranked candidates; `seconds` has the processor time that sampling would take."""
    lines = [
        f"{count_noun(len(causes.ranked), 'candidate')}, each at its maximum: log Bayes factor against "
        "the config as given, by Laplace's approximation, and the processor time that sampling would "
        "take"
    ]
    for cause in causes.ranked[:RANKED]:
        why = "; ".join(map(doubt, cause.doubts))
        doubts = f" [not to be trusted: {why}]" if why else ""
        minutes = seconds[cause.parts] / 60.0
        lines.append(f"  {cause.bayes:+10.1f}  {minutes:6.1f} min  {cause.about}{doubts}")
    return "\n".join(lines)


def ladder_opening(models: Mapping[str, str], missing: int) -> str:
    """List the models to be sampled, with descriptions; `missing` of them have not been sampled yet."""
    done = len(models) - missing
    before = f" ({done} of them done before)" if done else ""
    lines = [f"  {name}: {about}" for name, about in models.items()]
    return "\n".join([f"to sample{before}:", *lines])


def ladder_conclusion(about: str, left_out: Mapping[str, str], config: Path) -> str:
    """Describe the models that were left out, and the config to continue with."""
    missing = [f"left out: {name}: {reason}" for name, reason in left_out.items()]
    return "\n".join([*missing, f"recommended: {about}: {config}"])


def about_config(about: str, name: str, report: ComparisonReport) -> str:
    """Return the comment at the top of the recommended config."""
    verdict = next(iter(comparison_verdict(report.models)))
    simplest = "the simplest of the models that are about as probable as the best"
    return f"{name}: {about}, {simplest}.\n{verdict}"
