"""The files of a results folder: tables, figures, and the ArviZ tree."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import bayesdrill
from bayesdrill.basics.own_files import FIGURES as FOLDER
from bayesdrill.basics.own_files import whole
from bayesdrill.engines.workers import Crew
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.residual_checks import Left
from bayesdrill.insight.derived import summarise
from bayesdrill.insight.diagnostics import Row
from bayesdrill.insight.verdict import Judgement
from bayesdrill.report import (
    derived_words,
    identify_words,
    residual_words,
    tables,
    verdict_words,
    words,
)
from bayesdrill.report.figures import FIGURES
from bayesdrill.report.view import Drawing, View
from bayesdrill.results.run_folder import Folder
from bayesdrill.setup.build import compared_with
from bayesdrill.setup.config import Config

if TYPE_CHECKING:
    from xarray import DataTree

Array = NDArray[np.float64]


def everything(
    view: View, rows: Sequence[Row], left: Sequence[Left], folder: Folder, crew: Crew
) -> tuple[str, ...]:
    """What could not be made, and why; all else is written.

    Raises `OSError` when the disk is full; files already there stay whole.
    """
    place = (*_place(folder, view.config), words.warning(view.sampled, left))
    sparing, judged = view.sparing, view.judged
    tasks: list[tuple[str, Future[None]]] = []
    for name in FIGURES:
        with sparing.making(f"figures/{name}"):
            drawing = FIGURES[name](view)
            if drawing is not None:
                tasks.append((name, crew.submit(draw, name, drawing, *place)))
    # While others draw, the rest.
    folder.write_text("summary.csv", tables.as_csv(rows))
    second = "none"
    with sparing.making("derived.csv"):
        following = summarise(view.derived)
        folder.write_text("derived.csv", derived_words.as_csv(following))
        second = derived_words.as_markdown(following, view.derived)
    with sparing.making("summary.md"):
        folder.write_text("summary.md", _summary(view, rows, left, second))
    if judged is not None:
        with sparing.making("verdict.csv"):
            folder.write_text("verdict.csv", verdict_words.as_csv(judged.verdict))
    with sparing.making("posterior.nc"):
        _write_tree(view.tree, folder.place("posterior.nc"))
    for stem, task in tasks:
        with sparing.making(f"figures/{stem}"):
            task.result()
    return tuple(sparing.missing)


def _write_tree(tree: DataTree, path: Path) -> None:
    image = io.BytesIO()  # in memory: see pieces.chain_image
    tree.to_netcdf(image, engine="h5netcdf")
    with whole(path) as aside:
        aside.write_bytes(image.getvalue())


def _place(folder: Folder, config: Config) -> tuple[Path, dict[str, str]]:
    """Where figures go, and the note in each."""
    figures = folder.path / FOLDER
    figures.mkdir(exist_ok=True)
    return figures, {"Title": config.name, "Creator": f"bayesdrill {bayesdrill.__version__}"}


def draw(
    _: Posterior,
    stem: str,
    drawing: Drawing,
    folder: Path,
    note: Mapping[str, str],
    warning: str = "",
) -> None:
    from bayesdrill.report.style import save

    save(drawing.figure(*drawing.arguments), folder, stem, note, warning)


def _summary(view: View, rows: Sequence[Row], left: Sequence[Left], derived: str) -> str:
    config, sampled = view.config, view.sampled
    paragraphs = [
        f"# {config.name}",
        *_listed_if(
            words.unbelievable(
                residual_words.reasons(left), converged=sampled.convergence.converged
            )
        ),
        _listed(residual_words.sentences(left)),
        tables.as_markdown(rows).rstrip(),
        "`dev. %` is the deviation of the posterior mean from the nominal value "
        f"({compared_with(config)}); `shrinkage` is one minus the ratio of the posterior's to the "
        "prior's standard deviation.",
        _listed(tables.in_words(rows, tables.notes(rows))),
        "## What follows from these",
        derived,
        *_judged(config, view.judged, converged=sampled.convergence.converged),
        "## Maximum of the posterior (MAP)",
        _listed(words.mode(view.mode)),
        *_listed_if(words.maxima(view.mode, sampled)),
        "## Convergence",
        _listed(words.convergence(sampled)),
    ]
    return "\n\n".join(paragraphs) + "\n"


def _judged(config: Config, judged: Judgement | None, *, converged: bool) -> list[str]:
    if judged is None:
        return []
    verdict, table = judged.verdict, compared_with(config)
    nothing = "nothing found: energy, poles and sampling are as in a real rig"
    return [
        "## Verdict",
        _listed(verdict_words.sentences(verdict, table, converged=converged)),
        verdict_words.rule(verdict),
        verdict_words.as_markdown(verdict).rstrip(),
        verdict_words.EXPLAINED,
        "## What this record can show, at the MAP",
        f"```text\n{identify_words.structure(judged.study)}\n\n{identify_words.knowledge(judged.study)}\n```",
        "## Physical consistency of the posterior",
        _listed("\n".join(judged.findings) or nothing),
    ]


def _listed(text: str) -> str:
    return "\n".join(f"- {line.strip().removeprefix('- ')}" for line in text.splitlines())


def _listed_if(text: str) -> list[str]:
    return [_listed(text)] if text else []
