"""The files of the paper's reproduction: tables, figures, and a report that shows them in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesdrill.basics import own_files, software, symbols
from bayesdrill.engines import Crew
from bayesdrill.paper.pages.cells import Table
from bayesdrill.paper.pages.tables import in_words, tables
from bayesdrill.paper.searches.pairwise import ORDER, circle
from bayesdrill.paper.studies import printed
from bayesdrill.paper.studies.findings import Findings
from bayesdrill.report import (
    Drawing,
    Note,
    Picture,
    Section,
    Sentences,
    as_html,
    as_markdown,
    draw,
    made_of,
)
from bayesdrill.results import Folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TITLE = "The paper, repeated"
Wanted = tuple[str, str, Callable[..., "Figure"], tuple[Any, ...]]
ITERATIONS = 10  # of each pair, in the paper


def write(found: Findings, folder: Folder, crew: Crew) -> None:
    figures = folder.path / own_files.FIGURES
    figures.mkdir(exist_ok=True)
    note = {"Title": "paper", "Creator": software.creator()}
    wanted = _figures(found)
    tasks = [
        crew.submit(draw, stem, Drawing(figure, arguments), figures, note)
        for stem, _, figure, arguments in wanted
    ]
    made = tables(found)
    for table in made:
        folder.write_text(f"{table.stem}.csv", table.csv)
        folder.write_text(f"{table.stem}.md", f"{table.says}\n\n{table.markdown}")
    for task in tasks:
        task.result()
    said = sections(in_words(found), made, {stem: says for stem, says, *_ in wanted})
    folder.write_text("report.md", as_markdown(TITLE, said))
    every = (*said, made_of((("versions", software.in_words()),), folder.path))
    folder.write_text("report.html", as_html(TITLE, "the paper", every, figures))


def sections(
    first: Sequence[str], made: Sequence[Table], figures: Mapping[str, str]
) -> tuple[Section, ...]:
    """`first`: what is said before all tables."""
    tables = (Section(table.title, (Note(table.says), *table.grids)) for table in made)
    pictures = tuple(Picture(stem, says) for stem, says in figures.items())
    return (
        Section("What comes out", (Sentences("\n".join(first)),)),
        *tables,
        Section("Figures", pictures),
    )


def _paper(name: str) -> float:
    """What Table 3 prints; NaN of what is not in it."""
    return printed.NINE_PARAMETERS[name].value if name in printed.NINE_PARAMETERS else np.nan


def _figures(found: Findings) -> list[Wanted]:
    from bayesdrill.paper.pages import plots as plots
    from bayesdrill.paper.pages import search_plots as search
    from bayesdrill.paper.pages.table_plot import table_3_figure
    from bayesdrill.report import heuristic_figure, rig_figure

    heuristics = [(nine.name, nine.heuristic) for nine in found.nines]
    latex = [
        ", ".join(symbols.PARAMETERS[name].latex for name in names) for names in found.symmetries
    ]
    wanted: list[Wanted] = [
        ("rig", "The rig.", rig_figure, ()),
        (
            "heuristic",
            "The heuristic, as in the paper.",
            heuristic_figure,
            (circle(ORDER), ITERATIONS),
        ),
        (
            "matrix",
            "Speed of theta_2 with four readings of the printed matrix.",
            plots.readings_figure,
            (found.readings,),
        ),
        (
            "table_2",
            "Error of the two-parameter estimates against the noise.",
            plots.verification_figure,
            (found.verification, dict(printed.TWO_PARAMETERS)),
        ),
        (
            "simultaneous",
            "Where searches for all unknowns at once end.",
            search.simultaneous_figure,
            (found.ends, latex),
        ),
        (
            "convergence",
            "Misfit after each iteration of the heuristic.",
            search.convergence_figure,
            (heuristics,),
        ),
    ]
    for nine in found.nines:
        h = nine.heuristic
        wanted.append(
            (
                f"fit_{nine.name}",
                f"Record `{nine.name}` and the heuristic's fit.",
                plots.fit_paper_figure,
                (nine.experiment, nine.signals),
            )
        )
        paper = np.array([_paper(name) for name in nine.names])
        values = (nine.names, h.guess, h.estimate, h.others, nine.truth, nine.draws, paper)
        wanted.append(
            (
                f"table_3_{nine.name}",
                f"Record `{nine.name}`: the heuristic's estimates and the posterior.",
                table_3_figure,
                values,
            )
        )
    return wanted
