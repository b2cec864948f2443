"""The files of a results folder: tables, figures, and the ArviZ tree."""

from __future__ import annotations

import io
from collections.abc import Mapping
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
from bayesdrill.insight.derived import summarise
from bayesdrill.report import derived_words, tables, verdict_words, words
from bayesdrill.report.figures import FIGURES, drawing
from bayesdrill.report.run_report import sections
from bayesdrill.report.sections import as_markdown
from bayesdrill.report.view import Drawing, View
from bayesdrill.results.run_folder import Folder

if TYPE_CHECKING:
    from xarray import DataTree

Array = NDArray[np.float64]


def everything(view: View, folder: Folder, crew: Crew) -> tuple[str, ...]:
    """What could not be made, and why; all else is written.

    Raises `OSError` when the disk is full; files already there stay whole.
    """
    place = (*_place(folder, view), words.warning(view.sampled, view.left))
    sparing, following = view.sparing, None
    tasks: list[tuple[str, Future[None]]] = []
    wanted = view.config.output.figures
    for name in FIGURES if wanted is None else [name for name in FIGURES if name in wanted]:
        with sparing.making(f"figures/{name}"):
            found = drawing(name, view)
            if found is not None:
                tasks.append((name, crew.submit(draw, name, found, *place)))
    # While others draw, the rest.
    folder.write_text("summary.csv", tables.as_csv(view.rows))
    with sparing.making("derived.csv"):
        rows = summarise(view.derived)
        folder.write_text("derived.csv", derived_words.as_csv(rows))
        following = rows
    with sparing.making("summary.md"):
        page = as_markdown(view.config.name, sections(view, following))
        folder.write_text("summary.md", page)
    if view.judged is not None:
        with sparing.making("verdict.csv"):
            folder.write_text("verdict.csv", verdict_words.as_csv(view.judged.verdict))
    with sparing.making("posterior.nc"):
        _write_tree(view.tree, folder.place("posterior.nc"))
    for stem, task in tasks:
        with sparing.making(f"figures/{stem}"):
            task.result()
    return tuple(sparing.missing)


def tables_of(view: View) -> dict[str, str]:
    """The tables that follow from a chain, by their files."""
    made = {"summary.csv": tables.as_csv(view.rows)}
    made["derived.csv"] = derived_words.as_csv(summarise(view.derived))
    if view.judged is not None:
        made["verdict.csv"] = verdict_words.as_csv(view.judged.verdict)
    return made


def _write_tree(tree: DataTree, path: Path) -> None:
    image = io.BytesIO()  # in memory: see pieces.chain_image
    tree.to_netcdf(image, engine="h5netcdf")
    with whole(path) as aside:
        aside.write_bytes(image.getvalue())


def _place(folder: Folder, view: View) -> tuple[Path, dict[str, str]]:
    """Where figures go, and the note in each."""
    figures = folder.path / FOLDER
    figures.mkdir(exist_ok=True)
    creator = f"bayesdrill {bayesdrill.__version__}"
    return figures, {"Title": view.config.name, "Creator": creator, **view.marks}


def draw(
    _: Posterior,
    stem: str,
    what: Drawing,
    folder: Path,
    note: Mapping[str, str],
    warning: str = "",
) -> None:
    from bayesdrill.report.style import save

    own = {**note, "Title": f"{note['Title']}: {stem}"}
    save(what.figure(*what.arguments), folder, stem, own, warning)
