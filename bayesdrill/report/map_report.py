"""What is said and drawn of a maximum (MAP) alone: sections, tables, the fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import own_files
from bayesdrill.engines.mode import Mode
from bayesdrill.inference import residual_checks
from bayesdrill.inference.problem import Problem
from bayesdrill.inference.residual_checks import Left
from bayesdrill.report import (
    figures,
    prediction,
    provenance_words,
    residual_words,
    tables,
    words,
)
from bayesdrill.report.sections import Note, Picture, Section, Sentences, as_markdown, as_text
from bayesdrill.report.view import Drawing
from bayesdrill.results import provenance
from bayesdrill.setup import build, sources
from bayesdrill.setup.config import Config

Array = NDArray[np.float64]

TABLE, PREDICTION, PAGE, FIGURE = "map.csv", "prediction.csv", "map.md", "fit"


@dataclass(frozen=True)
class MapReport:
    problem: Problem
    config: Config
    mode: Mode

    @property
    def best(self) -> Array:
        """`(D,)`."""
        return self.problem.posterior.space.vector(self.mode.values)

    @cached_property
    def left(self) -> tuple[Left, ...]:
        """What the fit leaves of each channel."""
        return residual_checks.left(self.problem.posterior.likelihood, self.best)

    @property
    def warning(self) -> str:
        """What the figure carries; empty where there is nothing to warn of."""
        return words.misfit(self.left)

    @property
    def sections(self) -> tuple[Section, ...]:
        table = build.compared_with(self.config)
        read = f"`dev. %` is the deviation of the MAP from the nominal value ({table})."
        fit = Sentences(residual_words.sentences(self.left))
        searches = Sentences(words.mode(self.mode))
        return (
            Section("", (tables.of_mode(self.problem, self.mode), Note(read), fit)),
            Section("Figures", (Picture(FIGURE, figures.FIT_ALONE),), brief=False),
            Section("Maximum of the posterior (MAP)", (searches,), brief=False),
        )

    @property
    def text(self) -> str:
        """For a terminal."""
        return "\n".join(as_text(self.sections))

    @property
    def texts(self) -> Mapping[str, str]:
        """Files by name."""
        return {**self.numbers, PAGE: as_markdown(self.config.name, self.sections)}

    @property
    def numbers(self) -> Mapping[str, str]:
        """Those that follow from `map.json` alone."""
        return {
            TABLE: tables.mode_as_csv(self.problem, self.mode),
            PREDICTION: prediction.as_csv(self.problem, self.config, self.best),
        }

    def page(self, folder: Path) -> str:
        """HTML, with the picture and the config that stand in `folder`."""
        # Late: templates are for this page alone.
        from bayesdrill.report.html import as_html

        config = self.config
        marks = provenance.marks(config, self.problem, "")
        lines = (
            ("config", config.name),
            ("record", f"{sources.named(config)}: {marks['Record']}"),
            ("model", words.model(self.problem)),
            ("seed", marks["Seed"]),
            ("versions", marks["Versions"]),
        )
        every = (*self.sections, provenance_words.made_of(lines, folder))
        figures = folder / own_files.FIGURES
        return as_html(config.name, "maximum", every, figures, self.problem.symbols)

    @property
    def figure(self) -> Drawing:
        return figures.fit_alone(self.problem, self.config, self.best, self.left)
