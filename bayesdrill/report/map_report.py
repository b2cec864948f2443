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
from bayesdrill.inference.pieces import step_errors
from bayesdrill.inference.problem import Problem
from bayesdrill.inference.residual_checks import Left
from bayesdrill.report import (
    figures,
    prediction,
    provenance_words,
    residual_words,
    step_words,
    tables,
    words,
)
from bayesdrill.report.sections import Note, Picture, Section, Sentences, as_markdown, as_text
from bayesdrill.report.view import Drawing
from bayesdrill.results import provenance
from bayesdrill.setup import build, own_units
from bayesdrill.setup.config import Config
from bayesdrill.setup.own_units import OwnUnits

Array = NDArray[np.float64]

TABLE, PAGE = "map.csv", "map.md"


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
    def reasons(self) -> tuple[str, ...]:
        """Why it must not be believed: it does not fit; empty where it may be."""
        return residual_words.reasons(self.left)

    @property
    def sections(self) -> tuple[Section, ...]:
        table = build.compared_with(self.config)
        read = Note(f"`dev. %` is the deviation of the MAP from the nominal value ({table}).")
        own = OwnUnits.of(self.config, self.problem)
        clock = own_units.clock(self.config, self.problem)
        steps = step_words.sentences(step_errors(self.problem.posterior.likelihood, self.best))
        said = residual_words.sentences(self.left, clock)
        fit = Sentences("\n".join(filter(None, [said, steps])))
        searches = Sentences(words.mode(self.mode, own))
        shown = tables.of_mode(own.rows(tables.mode_rows(self.problem, self.mode)))
        beside = (shown, read) if "nominal" in shown.heads else (shown,)
        doubts = words.unbelievable(self.reasons, converged=False)
        shape = own_files.shown(self.config.output.formats)
        captions = figures.alone_captions(self.problem)
        pictures = tuple(Picture(stem, says, shape) for stem, says in captions.items())
        return (
            *((Section("", (Sentences(doubts),)),) if doubts else ()),
            Section("", (*beside, fit)),
            Section("Figures", pictures, brief=False),
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
            TABLE: tables.mode_as_csv(tables.mode_rows(self.problem, self.mode)),
            **prediction.as_csv(self.problem, self.config, self.best),
        }

    def page(self, folder: Path) -> str:
        """HTML, with the picture and the config that stand in `folder`."""
        # Late: templates are for this page alone.
        from bayesdrill.report.html import as_html

        config = self.config
        marks = provenance.marks(config, self.problem, "")
        lines = (
            ("config", config.name),
            *provenance_words.records(self.problem, config),
            ("model", words.model(self.problem)),
            ("seed", marks["Seed"]),
            ("versions", marks["Versions"]),
        )
        every = (*self.sections, provenance_words.made_of(lines, folder))
        figures = folder / own_files.FIGURES
        return as_html(config.name, "maximum", every, figures, self.problem.symbols)

    @property
    def figures(self) -> dict[str, Drawing]:
        """By stem."""
        return figures.fits_alone(self.problem, self.config, self.best, self.left)
