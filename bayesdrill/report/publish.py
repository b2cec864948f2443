"""The files of a results folder: tables, figures, and the ArviZ tree."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import own_files, software
from bayesdrill.basics.own_files import FIGURES as FOLDER
from bayesdrill.basics.progress import Reporter
from bayesdrill.engines.workers import Crew
from bayesdrill.inference.posterior import Posterior
from bayesdrill.report import (
    derived_words,
    latex,
    provenance_words,
    tables,
    torque_words,
    verdict_words,
)
from bayesdrill.report.figures import FIGURES, drawings, drawn
from bayesdrill.report.run_report import sections
from bayesdrill.report.sections import Picture, as_markdown
from bayesdrill.report.view import Drawing, View
from bayesdrill.report.widths import DPI
from bayesdrill.results.run_folder import Folder
from bayesdrill.setup.output_entries import MOST_NAMED

if TYPE_CHECKING:
    from xarray import DataTree

Array = NDArray[np.float64]


def _verdict(view: View) -> str | None:
    return (
        None
        if view.judged is None
        else verdict_words.as_csv(view.judged.verdict, view.problem.symbols)
    )


# What follows from a chain alone; None where a run has no such table.
TABLES: Mapping[str, Callable[[View], str | None]] = MappingProxyType(
    {
        "summary.csv": lambda view: tables.as_csv(view.rows),
        "derived.csv": lambda view: derived_words.as_csv(view.following),
        "verdict.csv": _verdict,
        "torque.csv": lambda view: torque_words.as_csv(view.shaking),
        "table.tex": lambda view: latex.table(
            view.units.rows(view.rows),
            view.units.symbols(view.problem.symbols),
            believed=not view.reasons,
        ),
    }
)


_SEVERAL = tuple(  # of as many experiments
    f"{stem}_{k}"
    for stem in ("fit", "friction", "energy", "torque")
    for k in range(1, MOST_NAMED + 1)
)


def everything(view: View, folder: Folder, crew: Crew, report: Reporter) -> tuple[str, ...]:
    """What could not be made, and why; all else is written.

    Raises `OSError` when the disk is full; files already there stay whole.
    """
    output, sparing = view.config.output, view.sparing
    place = (*_place(folder, view), view.warning, tuple(output.formats), output.dpi)
    tasks: list[tuple[str, str, Future[None]]] = []
    wanted = drawn(output.figures)
    folder.take_away(
        set(own_files.figures(*FIGURES, *_SEVERAL, formats=own_files.FORMATS))
        - set(own_files.figures(*wanted, formats=output.formats))
    )
    report.update(0.0, "making tables and figures")
    for k, name in enumerate(wanted, 1):
        report.update(0.5 * k / len(wanted), f"figure {name}")
        with sparing.making(f"figures/{name}"):
            for stem, found in drawings(name, view).items():
                tasks.append((stem, found.says, crew.submit(draw, stem, found, *place)))
    # While others draw, the rest.
    report.update(0.5, "tables")
    for name, table in TABLES.items():
        with sparing.making(name):
            text = table(view)
            if text is not None:
                folder.write_text(name, text)
    with sparing.making("posterior.nc"):
        _write_tree(view.tree, folder.place("posterior.nc"))
    pictures = []
    for k, (stem, says, task) in enumerate(tasks):
        report.update(0.6 + 0.4 * k / len(tasks), f"figure {stem}")
        with sparing.making(f"figures/{stem}"):
            task.result()
            pictures.append(Picture(stem, says or stem, own_files.shown(output.formats)))
    _pages(view, pictures, folder)
    return tuple(sparing.missing)


def _pages(view: View, pictures: Sequence[Picture], folder: Folder) -> None:
    """The report for eyes: as Markdown, and as one page of HTML with its pictures inside."""
    with view.sparing.making("summary.md"):
        folder.write_text("summary.md", as_markdown(view.config.name, sections(view, pictures)))
    with view.sparing.making("report.html"):
        # Late: templates are for this page alone.
        from bayesdrill.report.html import as_html

        made_of = provenance_words.section(view, folder.path)
        said = (*sections(view, pictures), made_of, provenance_words.cite(folder.path))
        figures = folder.path / FOLDER
        text = as_html(view.config.name, "posterior", said, figures, view.problem.symbols)
        folder.write_text("report.html", text)


def _write_tree(tree: DataTree, path: Path) -> None:
    image = io.BytesIO()
    tree.to_netcdf(image, engine="h5netcdf")
    own_files.write(path, image.getvalue())


def _place(folder: Folder, view: View) -> tuple[Path, dict[str, str]]:
    """Where figures go, and the note in each."""
    figures = folder.path / FOLDER
    figures.mkdir(exist_ok=True)
    return figures, {"Title": view.config.name, "Creator": software.creator(), **view.marks}


def draw(
    _: Posterior,
    stem: str,
    what: Drawing,
    folder: Path,
    note: Mapping[str, str],
    warning: str = "",
    formats: tuple[str, ...] = own_files.USUAL,
    dpi: int = DPI,
) -> None:
    from bayesdrill.report.style import save
    from bayesdrill.report.warning_strip import warned

    own = {**note, "Title": f"{note['Title']}: {stem}"}
    save(warned(what.drawn(), warning), folder, stem, own, formats=formats, dpi=dpi)
