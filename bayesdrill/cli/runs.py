"""Runs, and what is made of runs that are there."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayesdrill.cli.app import ConfigPath, Force, Processes, Scheduler, app, output_option
from bayesdrill.guard import INPUT_WRONG, NOT_CONVERGED, finish, guarded, saved_in, say


@app.command(epilog="Example: bayesdrill posterior configs/nominal_step.yaml --output results/mine")
def posterior(
    config: ConfigPath,
    output: Annotated[Path | None, output_option("Default: results/<name>.")] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Continue an interrupted run, or extend a finished one."),
    ] = False,
    force: Force = False,
    processes: Processes = None,
) -> None:
    """MAP, sampling, diagnostics, tables and figures: the main job."""
    with guarded():
        from bayesdrill.api.arguments import mode
        from bayesdrill.api.case import load
        from bayesdrill.basics.progress import reporter

        mode(resume=resume, force=force)  # before the record is read
        case = load(config)
        with saved_in(case.place(output)), reporter() as report:
            outcome = case.run(
                output, resume=resume, force=force, processes=processes, report=report
            )
        finish(outcome)


@app.command(epilog="Example: bayesdrill calibrate configs/nominal_step.yaml")
def calibrate(
    config: ConfigPath,
    output: Annotated[Path | None, output_option("Default: results/<name>-calibration.")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with an interrupted calibration, or extend one.")
    ] = False,
    force: Force = False,
    processes: Processes = None,
    scheduler: Scheduler = None,
) -> None:
    """Test the posterior of a config: refit simulated records, and see where the truth ranks."""
    with guarded():
        from bayesdrill.api.arguments import mode
        from bayesdrill.api.files import calibration
        from bayesdrill.basics.progress import reporter

        mode(resume=resume, force=force)
        case = calibration(config)
        with saved_in(case.place(output)), reporter() as report:
            outcome = case.run(
                output,
                resume=resume,
                force=force,
                processes=processes,
                scheduler=scheduler,
                report=report,
            )
        say(outcome.said)
        say(f"results: {outcome.folder}/ (report.html, summary.md, figures/, ranks.csv)")
        if not outcome.verdict.calibrated:
            raise typer.Exit(NOT_CONVERGED)


@app.command(epilog="Example: bayesdrill report results/nominal_step")
def report(
    folders: Annotated[
        list[Path], typer.Argument(metavar="FOLDER...", help="Of finished runs, one or several.")
    ],
    output: Annotated[
        Path | None, output_option("Default: of one where it is, of several results/<name>-<name>.")
    ] = None,
    force: Force = False,
    processes: Processes = None,
) -> None:
    """Make tables and figures again from a stored chain; of several runs, lay them over each other."""
    with guarded():
        from bayesdrill.api import files
        from bayesdrill.basics.progress import reporter

        if len(folders) > 1:
            _lay_over(folders, output, force=force)
            return
        with reporter() as told:
            outcome = files.publish(
                folders[0], output, force=force, processes=processes, report=told
            )
        finish(outcome)


def _lay_over(folders: list[Path], output: Path | None, *, force: bool) -> None:
    from bayesdrill.api.overlay import check_place, overlay

    place = check_place(folders, output, force=force)
    found = overlay(folders)
    found.save(place, force=force)
    say(found.text)
    say(f"results: {place}/ (report.html, overlay.md, overlay.csv, figures/)")
    if found.reasons:
        raise typer.Exit(NOT_CONVERGED)


@app.command(epilog="Example: bayesdrill compare results/nominal_step results/damped")
def compare(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="FOLDER...", help="Of finished runs of one record, two or more."),
    ],
    output: Annotated[Path | None, output_option("Default: results/compare-<name>-<name>.")] = None,
    force: Force = False,
) -> None:
    """Say which model of a record is the more probable, and whether model or noise makes it so."""
    with guarded():
        from bayesdrill.api.compare import check_place
        from bayesdrill.api.compare import compare as compared

        place = check_place(folders, output, force=force)
        found = compared(folders)
        found.save(place, force=force)
        say(found.text)
        say(f"results: {place}/ (report.html, comparison.md, comparison.csv, figures/)")
        if found.reasons:
            raise typer.Exit(NOT_CONVERGED)


@app.command(epilog="Example: bayesdrill ladder configs/nominal_step.yaml")
def ladder(
    config: ConfigPath,
    output: Annotated[Path | None, output_option("Default: results/<name>-ladder.")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with an interrupted ladder.")
    ] = False,
    force: Force = False,
    processes: Processes = None,
    scheduler: Scheduler = None,
) -> None:
    """Try what a config may be missing (noise, friction, damping), compare, and recommend a config."""
    with guarded():
        from bayesdrill.api.arguments import mode
        from bayesdrill.api.ladder import ladder as made
        from bayesdrill.basics.progress import reporter

        mode(resume=resume, force=force)
        every = made(config)
        with saved_in(every.place(output)), reporter() as report:
            outcome = every.run(
                output,
                resume=resume,
                force=force,
                processes=processes,
                scheduler=scheduler,
                report=report,
            )
        say(outcome.said)
        say(f"results: {outcome.folder}/ (report.html, comparison.md, recommended.yaml, ...)")
        if outcome.report.reasons:
            raise typer.Exit(NOT_CONVERGED)


@app.command(epilog="Example: bayesdrill verify results/nominal_step")
def verify(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of a finished run.")],
) -> None:
    """Say whether config, record, tables and figures of a run still belong together."""
    with guarded():
        from bayesdrill.api import files

        found = files.verify(folder)
        say(found.said, err=not found.together)
        if not found.together:
            raise typer.Exit(INPUT_WRONG)
