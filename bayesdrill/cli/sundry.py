"""Records that are made, the paper, the schema, how to cite."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from bayesdrill.cli.app import ConfigPath, Force, Processes, app, output_option
from bayesdrill.guard import NOT_CONVERGED, guarded, saved_in, say


class CitationForm(StrEnum):
    text = "text"
    bibtex = "bibtex"
    cff = "cff"


@app.command(epilog="Example: bayesdrill simulate configs/nominal_step.yaml --output my_record.csv")
def simulate(
    config: ConfigPath,
    output: Annotated[Path | None, output_option("Default: what the config names.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Default: the config's.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite simulated records.")] = False,
) -> None:
    """Make a record from the config (of several experiments, one each): response plus noise, as CSV."""
    with guarded():
        from bayesdrill.api import files

        made = files.simulate(config, output, seed=seed, force=force)
        for path, samples in made.files.items():
            say(f"{path}: {samples} samples")


@app.command(epilog="Example: bayesdrill paper --output results/paper")
def paper(
    configs: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="With the configs of the studies.")
    ] = Path("configs/paper"),
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for tables and figures.")
    ] = Path("results/paper"),
    force: Force = False,
    processes: Processes = None,
) -> None:
    """Repeat the studies of the paper, each beside what a full posterior says of it (minutes)."""
    with guarded():
        from bayesdrill.api.arguments import workers
        from bayesdrill.basics.progress import reporter
        from bayesdrill.paper.run import reproduce

        with saved_in(output, "start over with --force"), reporter() as report:
            done = reproduce(configs, output, workers(processes), report, force=force)
        say("\n".join(done.said))
        say(f"results: {done.folder}/ (report.html, report.md, tables, figures/, two posteriors)")
        if not done.converged:
            raise typer.Exit(NOT_CONVERGED)


@app.command(epilog="Example: bayesdrill schema > schema.json")
def schema() -> None:
    """Print the JSON schema of configs, for editors that complete and check them."""
    with guarded():
        from bayesdrill.api import files

        typer.echo(files.schema(), nl=False)


@app.command(epilog="Example: bayesdrill cite results/nominal_step --format bibtex")
def cite(
    folder: Annotated[
        Path | None,
        typer.Argument(metavar="FOLDER", help="Of a run; default: what is installed."),
    ] = None,
    form: Annotated[
        CitationForm, typer.Option("--format", help="To read, for BibTeX, or as CITATION.cff.")
    ] = CitationForm.text,
) -> None:
    """Say how to cite bayesdrill and what a run stands on."""
    with guarded():
        from bayesdrill.api.citation import citation

        say(getattr(citation(folder), form.value).rstrip("\n"))
