"""Report the maximum of a posterior (MAP) without sampling: sections, tables and figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from bayesdrill import output_files
from bayesdrill.analysis.delay_confounding import delays_and_time_constants
from bayesdrill.basics import software
from bayesdrill.basics.arrays import Array
from bayesdrill.config.schema.config import Config
from bayesdrill.inference import residual_checks
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.residual_checks import ResidualCorrelation, ResidualSummary
from bayesdrill.inference.step_error import step_errors
from bayesdrill.output_files import numbered
from bayesdrill.report import publish, section, words
from bayesdrill.report.doubts import (
    map_notes,
    misfit,
    residual_reasons,
    residual_sentences,
    step_sentences,
    unbelievable,
)
from bayesdrill.report.findings import finding_sentences
from bayesdrill.report.render import as_html
from bayesdrill.report.run_report import made_of, provenance_of_records
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.section import Note, Picture, Section, as_markdown, as_text, build
from bayesdrill.report.sections.convergence import describe_map
from bayesdrill.report.sections.fit import FIT_ALONE, every_fit, fit_figure, prediction_csv
from bayesdrill.report.sections.parameters import ModeRow, mode_rows, of_mode
from bayesdrill.report.sections.residuals import residual_drawings
from bayesdrill.report.view import Drawing, for_each_experiment
from bayesdrill.results import provenance
from bayesdrill.sampling.mode_search import Mode

TABLE, PAGE = "map.csv", "map.md"


@dataclass(frozen=True)
class MapReport:
    """The report describes the maximum of a posterior that was not sampled."""

    problem: Problem
    config: Config
    mode: Mode

    @property
    def best(self) -> Array:
        """Return the maximum as a vector `(D,)`."""
        return self.problem.posterior.space.vector(self.mode.values)

    @cached_property
    def residuals(self) -> tuple[ResidualSummary, ...]:
        """Return the summary of the residuals of each channel."""
        return residual_checks.residual_summaries(self.problem.posterior.likelihood, self.best)

    @cached_property
    def correlations(self) -> tuple[ResidualCorrelation, ...]:
        """Return correlations of the residuals if the residuals are more than noise, or none."""
        if residual_checks.like_noise(self.residuals):
            return ()
        return residual_checks.correlations(self.problem.posterior.likelihood, self.best)

    @property
    def warning(self) -> str:
        """Return the warning that figures carry; it may be empty."""
        return misfit(self.residuals)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return reasons not to believe the maximum (the model does not fit), or none."""
        return residual_reasons(self.residuals)

    def _sections(self, figures: Mapping[str, Drawing]) -> tuple[Section, ...]:
        table = self.problem.compared_with
        read = Note(f"`dev. %` is the deviation of the MAP from {table}.")
        units, clock = self.problem.units, self.problem.clock
        steps = step_sentences(step_errors(self.problem.posterior.likelihood, self.best))
        said = residual_sentences(self.residuals, clock)
        shown = of_mode(units.rows(mode_rows(self.problem, self.mode)))
        doubts = unbelievable(self.reasons, converged=False)
        shape = output_files.preferred_format(self.config.output.formats_or_default)
        pictures = [Picture(stem, drawing.says, shape) for stem, drawing in figures.items()]
        inputs = finding_sentences(residual_checks.followed_inputs(self.correlations))
        delays = delays_and_time_constants(self.problem.posterior, self.best)
        notes = [*map_notes(self.problem, self.mode), *finding_sentences(delays)]
        fit = "\n".join(filter(None, [*notes, said, *(f"fit: {line}" for line in inputs), steps]))
        return (
            *([build("", doubts)] if doubts else []),
            build("Fit", fit, *pictures),
            build("Parameters", shown, read if "nominal" in shown.heads else None),
            build("Maximum of the posterior (MAP)", describe_map(self.mode, units), brief=False),
        )

    @cached_property
    def sections(self) -> tuple[Section, ...]:
        """Return the sections of the page, including the figures, which a terminal does not show."""
        return self._sections(self.figures)

    @property
    def text(self) -> str:
        """Return the report for a terminal."""
        return "\n".join(as_text(self._sections({})))

    @property
    def texts(self) -> Mapping[str, str]:
        """Return the contents of the text files by name."""
        return {
            TABLE: section.records_as_csv(ModeRow, mode_rows(self.problem, self.mode)),
            **prediction_csv(self.problem, self.best),
            PAGE: as_markdown(self.config.name, self.sections),
        }

    def draw(self, folder: Path, title: str, **marks: str) -> None:
        """Draw all figures into `folder`/figures; `title` and `marks` are metadata of the files."""
        place, output = folder / output_files.FIGURES, self.config.output
        place.mkdir(exist_ok=True)
        note = {"Title": title, "Creator": software.creator(), **marks}
        look = (self.warning, output.formats_or_default, output.dpi)
        for stem, drawing in self.figures.items():
            publish.draw(self.problem.posterior, stem, drawing, place, note, *look)

    def page(
        self,
        folder: Path,
        *more: Section,
        title: str | None = None,
        parent: tuple[str, str] | None = None,
    ) -> str:
        """Return the HTML page, with pictures and config from `folder`, and `more` sections last.

        The title is the name of the config by default; `as_html` explains `parent`.
        """
        config = self.config
        marks = provenance.marks(config, self.problem)
        lines = (
            ("config", config.name),
            *provenance_of_records(self.problem),
            ("model", words.model(self.problem)),
            ("seed", marks["Seed"]),
            ("versions", marks["Versions"]),
        )
        every = (*self.sections, *more, made_of(lines, folder))
        figures = folder / output_files.FIGURES
        name = config.name if title is None else title
        return as_html(name, "maximum", every, figures, self.problem.symbols, parent)

    @cached_property
    def figures(self) -> Mapping[str, Drawing]:
        """Return the figures by the stems of their files."""
        problem, width = self.problem, WIDTHS[self.config.output.size]
        shown = ((fit.label, fit) for fit in every_fit(problem, self.best, self.residuals))
        fits = numbered("fit", for_each_experiment(fit_figure, shown, width, FIT_ALONE))
        residuals = residual_drawings(self.correlations, width, problem.model)
        return fits | numbered("residuals", residuals)
