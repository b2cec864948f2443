"""Write the files of a run: tables, figures, and the ArviZ tree."""

from __future__ import annotations

import io
from collections.abc import Collection, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from types import MappingProxyType

from bayesdrill import output_files
from bayesdrill.basics import software
from bayesdrill.basics.errors import ErrorCollector
from bayesdrill.basics.progress import Reporter
from bayesdrill.basics.registry import Registry, check_callable
from bayesdrill.config.schema.records import MAX_NAMED
from bayesdrill.inference.posterior import Posterior
from bayesdrill.output_files import FIGURES as FOLDER
from bayesdrill.output_files import ON_REQUEST, OWN_FIGURES, PER_EXPERIMENT, numbered
from bayesdrill.report import render, run_report
from bayesdrill.report.run_report import PARTS, sections
from bayesdrill.report.scales import DPI
from bayesdrill.report.section import Picture, as_markdown
from bayesdrill.report.view import Drawing, Recipe, ReportContext
from bayesdrill.results.run_folder import Folder
from bayesdrill.sampling.workers import WorkerPool


def drawings(name: str, run: ReportContext) -> dict[str, Drawing]:
    """Return the drawings of a figure (one, or one for each experiment) by the stems of their files.

    Raises `TypeError` if the recipe returns anything except drawings and None.
    """
    given = FIGURES[name](run)
    figures = given if isinstance(given, tuple) else () if given is None else (given,)
    for figure in figures:
        if not isinstance(figure, Drawing):
            raise TypeError(f"a recipe gives a Drawing or None, not {type(figure).__name__}")
    return numbered(name, figures)


_DRAWN_BY = {name: draw for part in PARTS for name, draw in part.figures.items()}
FIGURES: Registry[Recipe] = Registry(
    "figure", {name: _DRAWN_BY[name] for name in OWN_FIGURES}, judge=check_callable
)


def wanted_figures(names: Collection[str] | None) -> list[str]:
    """Return the names of figures to draw: `names` or, for None, all except `ON_REQUEST`."""
    if names is None:
        return [name for name in FIGURES if name not in ON_REQUEST]
    return [name for name in FIGURES if name in names]


# By file name, functions that return a table as text, or None if a run has no such table.
TABLES = MappingProxyType({name: text for part in PARTS for name, text in part.files.items()})
_SEVERAL = tuple(f"{stem}_{k}" for stem in PER_EXPERIMENT for k in range(1, MAX_NAMED + 1))


@dataclass(frozen=True, slots=True)
class PendingFigures:
    """Workers of `pool` draw the figures in `tasks`; `formats` has the formats of all wanted figures."""

    pool: WorkerPool
    formats: Mapping[str, tuple[str, ...]]
    tasks: dict[str, list[tuple[str, str, Future[None]]]]
    errors: ErrorCollector


def begin_figures(
    view: ReportContext, folder: Folder, pool: WorkerPool, report: Reporter, *, pdf: bool = False
) -> PendingFigures:
    """Begin to draw the figures that need no analysis; with `pdf`, each figure is saved as PDF too."""
    output, errors = view.config.output, ErrorCollector()
    figures = folder.path / FOLDER
    figures.mkdir(exist_ok=True)
    wanted = wanted_figures(output.figures)
    formats = {name: output_files.formats_of(name, output.formats, pdf=pdf) for name in wanted}
    written = (output_files.figure_files(name, formats=formats[name]) for name in wanted)
    folder.remove_stale(
        {*output_files.figure_files(*FIGURES, *_SEVERAL, formats=output_files.FORMATS)}
        - {*chain.from_iterable(written)}
        | {*output_files.OUTDATED}
    )
    first = {name: formats[name] for name in wanted if name in output_files.FROM_DRAWS}
    if not {*(output.corner or output.parameters or ())} <= {*view.problem.names}:
        first.pop("corner", None)  # derived quantities need the analysis
    tasks = _begin_figures(first, view, figures, pool, report, errors)
    return PendingFigures(pool, formats, tasks, errors)


def write_results(
    view: ReportContext, folder: Folder, begun: PendingFigures, report: Reporter
) -> tuple[str, ...]:
    """Write all files of a run; return the names of missing files, with reasons.

    Raises `OSError` if the disk is full; existing files are not damaged.
    """
    formats, tasks, errors = begun.formats, begun.tasks, begun.errors
    figures, wanted = folder.path / FOLDER, [*formats]
    report.update(0.0, "analysing the draws")
    _ = view.analysis  # evaluate the analysis while other processes draw
    report.update(0.0, "making tables and figures")
    others = {name: formats[name] for name in wanted if name not in tasks}
    tasks |= _begin_figures(others, view, figures, begun.pool, report, errors)
    report.update(0.5, "tables")
    for name, table in TABLES.items():
        with errors.collect(name):
            text = table(view)
            if text is not None:
                folder.write_text(name, text)
    with errors.collect("posterior.nc"):
        image = io.BytesIO()
        view.tree.to_netcdf(image, engine="h5netcdf")
        output_files.write(folder.path_of("posterior.nc"), image.getvalue())
    every = [(name, *task) for name in wanted for task in tasks[name]]
    pictures: dict[str, list[Picture]] = {name: [] for name in wanted}
    for k, (name, stem, says, task) in enumerate(every):
        report.update(0.6 + 0.4 * k / len(every), f"figure {stem}")
        with errors.collect(f"figures/{stem}"):
            task.result()
            pictures[name].append(
                Picture(stem, says or stem, output_files.preferred_format(formats[name]))
            )
    with errors.collect("summary.md and report.html"):
        said = sections(view, pictures)
        with errors.collect("summary.md"):
            folder.write_text("summary.md", as_markdown(view.config.name, said))
        with errors.collect("report.html"):
            made_of = run_report.provenance_section(view, folder.path)
            page = (*said, made_of, run_report.cite())
            text = render.as_html(
                view.config.name, "posterior", page, figures, view.problem.symbols
            )
            folder.write_text("report.html", text)
    return (*view.chain.errors.missing, *errors.missing)


def _begin_figures(
    names: Mapping[str, tuple[str, ...]],
    view: ReportContext,
    folder: Path,
    pool: WorkerPool,
    report: Reporter,
    errors: ErrorCollector,
) -> dict[str, list[tuple[str, str, Future[None]]]]:
    output = view.config.output
    tasks: dict[str, list[tuple[str, str, Future[None]]]] = {name: [] for name in names}
    note = {"Title": view.config.name, "Creator": software.creator(), **view.marks}
    for k, (name, formats) in enumerate(names.items(), 1):
        report.update(0.5 * k / len(names), f"figure {name}")
        with errors.collect(f"figures/{name}"):
            for stem, drawing in drawings(name, view).items():
                look = (note, view.warning, formats, output.dpi)
                task = pool.submit(draw, stem, drawing, folder, *look)
                tasks[name].append((stem, drawing.says, task))
    return tasks


def draw(
    _: Posterior,
    stem: str,
    what: Drawing,
    folder: Path,
    note: Mapping[str, str],
    warning: str = "",
    formats: tuple[str, ...] = output_files.DEFAULT_FORMATS,
    dpi: int = DPI,
) -> None:
    """Draw a figure and save its files, in a worker process."""
    from bayesdrill.report.style import save, warned

    metadata = {**note, "Title": f"{note['Title']}: {stem}"}
    save(warned(what.drawn(), warning), folder, stem, metadata, formats=formats, dpi=dpi)
