"""What comes before anything is sampled: examples, a first config, checks, the maximum."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayesdrill.cli.app import ConfigPath, Force, Processes, app, output_option
from bayesdrill.guard import NOT_CONVERGED, guarded, say


@app.command(epilog="Example: bayesdrill example my_rig")
def example(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Nothing in it is overwritten.")
    ] = Path("configs"),
) -> None:
    """Write the bundled configs and records into a folder, to begin with."""
    with guarded():
        from bayesdrill.api.example import example as write

        say(str(write(folder)))


@app.command(epilog="Example: bayesdrill init configs/records/example_rig.csv --output my_rig.yaml")
def init(
    records: Annotated[list[Path], typer.Argument(metavar="RECORD...", help="What was measured.")],
    output: Annotated[Path | None, output_option("The config; default: beside the record.")] = None,
    voltage: Annotated[
        float | None,
        typer.Option(metavar="VOLTS", help="The supply, where it is constant and in no column."),
    ] = None,
    gear: Annotated[
        float | None, typer.Option(metavar="N", help="Of a gear N:1 between motor and shaft.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a config.")] = False,
) -> None:
    """Look at records and write a first config for them, with every guess marked and its reason."""
    with guarded():
        from bayesdrill.api.init import init as write

        say(str(write(records, output, voltage=voltage, gear=gear, force=force)))


@app.command(epilog="Example: bayesdrill check configs/nominal_step.yaml")
def check(config: ConfigPath) -> None:
    """Validate config and record and say what would run; samples nothing, writes nothing."""
    with guarded():
        from bayesdrill.api.case import load

        say(load(config).preview())


@app.command(epilog="Example: bayesdrill identify configs/nominal_step.yaml --profile k_s")
def identify(
    config: ConfigPath,
    profile: Annotated[
        list[str] | None,
        typer.Option(
            "--profile", metavar="NAME", help="Profile likelihood of a parameter, or of `all`."
        ),
    ] = None,
    at_map: Annotated[
        bool,
        typer.Option("--at-map", help="At the MAP, which is searched first; default: the start."),
    ] = False,
    output: Annotated[
        Path | None, output_option("Folder for text and figures; default: print only.")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Overwrite text and figures of an `identify` before.")
    ] = False,
    processes: Processes = None,
) -> None:
    """Say what this record can and cannot determine, and what would help; samples nothing."""
    with guarded():
        from bayesdrill.api.case import load
        from bayesdrill.basics.progress import reporter

        case = load(config)
        if output is not None:
            case.check_place(output, force=force)
        with reporter() as report:
            at = case.find_map(processes=processes, report=report) if at_map else None
            findings = case.identify(profile or [], at=at, report=report)
        say(findings.text)
        if output is not None:
            say("\nwritten: " + findings.save(output, force=force))


@app.command("map", epilog="Example: bayesdrill map configs/nominal_step.yaml")
def map_(
    config: ConfigPath,
    output: Annotated[
        Path | None, output_option("Folder for values, prediction and fit; default: none.")
    ] = None,
    force: Force = False,
    processes: Processes = None,
) -> None:
    """Search the maximum of the posterior (MAP) and print it; writes what it predicts if asked to."""
    with guarded():
        from bayesdrill.api.case import load
        from bayesdrill.api.run import Best
        from bayesdrill.basics.progress import reporter

        case = load(config)
        if output is not None:
            Best.check_place(output, force=force)
        with reporter() as report:
            best = case.find_map(processes=processes, report=report)
        say(best.table)
        if output is not None:
            place = best.save(output, force=force)
            say(f"results: {place}/ (report.html, map.md, prediction*.csv, figures/)")
        if best.reasons:
            raise typer.Exit(NOT_CONVERGED)
