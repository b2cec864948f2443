"""Write the paper's reproduction: tables in its order, figures, and a report that shows them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesdrill import output_files
from bayesdrill.analysis import plausibility
from bayesdrill.basics import software, symbols
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
from bayesdrill.rig import MotorShaft
from bayesdrill.sampling import WorkerPool
from studies.paper import printed
from studies.paper.findings import PaperFindings
from studies.paper.optimisers import ORDER, circle
from studies.paper.study_tables import doubts, lines_2, lines_3, percent, tables

TITLE = "The paper, repeated"
ITERATIONS = 10  # of each pair, in the paper


def files_of(records: Sequence[str]) -> output_files.Kind:
    """Return the files of the studies; each of `records` has a posterior in a folder of its own."""
    tables = (
        *("table_1", "inconsistencies", "matrix", "integrator", "table_2", "implied", "lengths"),
        *("simultaneous", "control", "misfits", "shaft"),
        *(f"{stem}_{name}" for name in records for stem in ("table_3", "products", "verdict")),
    )
    drawn = (
        *("rig", "heuristic", "matrix", "table_2", "simultaneous", "convergence"),
        *(f"{stem}_{name}" for name in records for stem in ("fit", "table_3")),
    )
    return output_files.Kind(
        "paper",
        (
            *(f"{stem}.{end}" for stem in tables for end in ("csv", "md")),
            *("report.md", "report.html", *output_files.figure_files(*drawn)),
        ),
        nested=tuple(records),
        continue_hint=output_files.MADE_ANEW,
    )


def in_words(findings: PaperFindings) -> tuple[str, ...]:
    """Say what a reader of the paper wants to know first, and what must not be believed."""
    sentences = [
        f"Table 2, sigma_n {line['sigma']:g}: c_m can be known to {percent(line['bound_percent'])} %; "
        f"the paper reports {line['printed_percent']:g} %"
        for line in lines_2(findings.verification)
        if line["parameter"] == "c_m"
    ]
    for nine in findings.nines:
        lines = [line for line in lines_3(nine) if line["truth"] is not None]
        misfit = nine.misfits["heuristic"]
        text = f"{nine.name}: the heuristic ends at a misfit of {misfit:.3f} per number"
        if lines:
            worst = max(lines, key=lambda line: abs(line["off_percent"]))
            inside = sum(line["holds"] for line in lines)
            text += (
                f", {worst['parameter']} {worst['off_percent']:+.0f} % off; the posterior's 94 % "
                f"intervals hold the truth of {inside} of {len(lines)} parameters"
            )
        sentences += [text, *(f"{nine.name}: {doubt}" for doubt in doubts(nine))]
    if not findings.verification.converged:
        sentences.append("Table 2: a posterior did not converge: do not use `posterior sd`")
    return tuple(sentences)


def write(findings: PaperFindings, folder: Folder, pool: WorkerPool) -> None:
    """Write all files of the reproduction to `folder`."""
    figures = folder.path / output_files.FIGURES
    figures.mkdir(exist_ok=True)
    note = {"Title": "paper", "Creator": software.creator()}
    wanted = drawings(findings)
    tasks = [pool.submit(draw, stem, drawing, figures, note) for stem, drawing in wanted.items()]
    report_tables = tables(findings)
    for table in report_tables:
        folder.write_text(f"{table.stem}.csv", table.csv)
        folder.write_text(f"{table.stem}.md", f"{table.says}\n\n{table.markdown}")
    for task in tasks:
        task.result()
    page = (
        Section("What comes out", (Sentences("\n".join(in_words(findings))),)),
        *(Section(table.title, (Note(table.says), *table.grids)) for table in report_tables),
        Section("Figures", tuple(Picture(stem, each.says) for stem, each in wanted.items())),
    )
    folder.write_text("report.md", as_markdown(TITLE, page))
    made = made_of((("versions", software.versions_text()),), folder.path)
    folder.write_text("report.html", as_html(TITLE, "the paper", (*page, made), figures))


def drawings(findings: PaperFindings) -> dict[str, Drawing]:
    """Return the figures, by the stems of their files."""
    # Late: matplotlib takes a second to load.
    from bayesdrill.report import fit_figure, rig_figure, scales
    from studies.paper import plots
    from studies.paper.schematics import heuristic_figure

    known = symbols.PARAMETERS
    scaled = [", ".join(known[name].latex for name in names) for names in findings.symmetries]
    wanted = {
        "rig": Drawing(
            rig_figure,
            (MotorShaft(), [signal.label.name for signal in findings.nines[0].fit.signals]),
            "The rig. Its shaft is of steel, "
            f"{plausibility.SHAFT_LENGTH:g} m long and {1e3 * plausibility.SHAFT_DIAMETER:g} mm thick.",
        ),
        "heuristic": Drawing(
            heuristic_figure, (circle(ORDER), ITERATIONS), "The heuristic, as in the paper."
        ),
        "matrix": Drawing(
            plots.readings_figure,
            (findings.readings,),
            "Speed of theta_2 with four readings of the printed matrix.",
        ),
        "table_2": Drawing(
            plots.verification_figure,
            (findings.verification, printed.TWO_PARAMETERS),
            "Error of the two-parameter estimates against the noise.",
        ),
        "simultaneous": Drawing(
            plots.simultaneous_figure,
            (findings.ends, scaled),
            "Where searches for all unknowns at once end.",
        ),
        "convergence": Drawing(
            plots.convergence_figure,
            ([(nine.name, nine.heuristic) for nine in findings.nines],),
            "Misfit after each iteration of the heuristic.",
        ),
    }
    for nine in findings.nines:
        estimates = [printed.NINE_PARAMETERS.get(name) for name in nine.names]
        paper = np.array([np.nan if estimate is None else estimate.value for estimate in estimates])
        wanted[f"fit_{nine.name}"] = Drawing(
            fit_figure,
            (nine.fit, scales.DOUBLE, "the estimate"),
            f"Record `{nine.name}` and the heuristic's fit.",
        )
        wanted[f"table_3_{nine.name}"] = Drawing(
            plots.table_3_figure,
            (nine.names, nine.heuristic, nine.truth, nine.draws, paper),
            f"Record `{nine.name}`: the heuristic's estimates and the posterior.",
        )
    return wanted
