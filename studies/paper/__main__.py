"""The command `python -m studies.paper`: the studies in, tables, figures and a report out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayesdrill.api import arguments
from bayesdrill.basics import progress
from bayesdrill.guard import NOT_CONVERGED, guarded, saved_in, say
from studies.paper.reproduction import in_words
from studies.paper.run import reproduce

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
@guarded()
def main(
    configs: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="With the configs of the studies.")
    ] = Path("configs/paper"),
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for tables and figures.")
    ] = Path("results/paper"),
    force: Annotated[
        bool, typer.Option("--force", help="Discard existing results and start over.")
    ] = False,
    processes: Annotated[
        int | None,
        typer.Option(min=1, max=256, help="Number of processes; the result does not depend on it."),
    ] = None,
) -> None:
    """Repeat the studies of the paper, each beside what a full posterior says of it (minutes)."""
    with saved_in(output, "start over with --force"), progress.reporter() as report:
        done = reproduce(configs, output, arguments.workers(processes), report, force=force)
    say("\n".join(in_words(done)))
    say(f"results: {output}/ (report.html, report.md, tables, figures/, two posteriors)")
    if not done.converged:
        raise typer.Exit(NOT_CONVERGED)


if __name__ == "__main__":
    app(prog_name="python -m studies.paper")
