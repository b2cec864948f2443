"""The command line: parse, call, print; nothing else.

`guard` says what the exit status means.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayesdrill import __version__
from bayesdrill.commands.guard import INPUT_WRONG, NOT_CONVERGED, guarded, saved_in

if TYPE_CHECKING:
    from bayesdrill.commands.calibrate import Outcome as Calibrated
    from bayesdrill.commands.pipeline import Outcome
    from bayesdrill.results.run_folder import Mode

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="What a record says about the nine parameters of a torsional drilling rig.",
)

ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="Experiment config (YAML).")]
Force = Annotated[bool, typer.Option("--force", help="Discard what is there and start over.")]
Processes = Annotated[
    int | None, typer.Option(min=1, max=256, help="Processes; the result does not depend on it.")
]


def _tell_version(wanted: bool) -> None:
    """Eager, so that `--version` needs no command."""
    if wanted:
        typer.echo(f"bayesdrill {__version__}")
        raise typer.Exit


@app.callback()
def top(
    _: Annotated[
        bool,
        typer.Option(
            "--version", callback=_tell_version, is_eager=True, help="Print the version and stop."
        ),
    ] = False,
) -> None:
    pass


@app.command(epilog="Example: bayesdrill check configs/nominal_step.yaml")
def check(config: ConfigPath) -> None:
    """Validate config and record and say what would run; samples nothing, writes nothing."""
    with guarded():
        from bayesdrill.commands.identify import preflight
        from bayesdrill.insight.identifiability.scenes import Scenery
        from bayesdrill.report import record_words, words
        from bayesdrill.setup.job import prepare

        job = prepare(config)
        typer.echo(words.opening(job.problem))
        typer.echo(record_words.columns(job.problem, job.config))
        typer.echo(words.preview(job.problem, job.config))
        typer.echo(preflight(job, Scenery(job.problem.posterior.likelihood)))


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
        Path | None,
        typer.Option("--output", "-o", help="Folder for text and figures; default: print only."),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Overwrite text and figures of an `identify` before.")
    ] = False,
    processes: Processes = None,
) -> None:
    """Say what this record can and cannot determine, and what would help; samples nothing."""
    with guarded():
        from bayesdrill.basics.progress import reporter
        from bayesdrill.commands import identify as job_
        from bayesdrill.engines.workers import available
        from bayesdrill.setup.job import prepare

        job = prepare(config)
        if output is not None:
            job_.check_place(output, force=force)
        space = job.problem.posterior.space
        with reporter() as report:
            at, values = "the start", space.start
            if at_map:
                from bayesdrill.commands import (  # late: it loads all that sampling needs
                    searching,
                )

                at = "the MAP"
                values = searching.find_mode(job, processes or available(), report).values
            findings = job_.identify(job, space.vector(values), at, profile or [], report)
        typer.echo(findings.text)
        if output is not None:
            typer.echo("\nwritten: " + job_.publish(job, findings, output, force=force))


@app.command("map", epilog="Example: bayesdrill map configs/nominal_step.yaml")
def map_(config: ConfigPath, processes: Processes = None) -> None:
    """Search the maximum of the posterior (MAP) and print it; writes nothing."""
    with guarded():
        from bayesdrill.basics.progress import reporter
        from bayesdrill.commands import pipeline, searching
        from bayesdrill.engines.workers import available
        from bayesdrill.inference import residual_checks
        from bayesdrill.report import residual_words
        from bayesdrill.report.tables import mode_as_text

        job = pipeline.prepare(config)
        with reporter() as report:
            found = searching.find_mode(job, processes or available(), report)
        target = job.problem.posterior
        left = residual_checks.left(target.likelihood, target.space.vector(found.values))
        typer.echo(mode_as_text(job.problem, found))
        typer.echo(residual_words.sentences(left))


@app.command(epilog="Example: bayesdrill posterior configs/nominal_step.yaml --output results/mine")
def posterior(
    config: ConfigPath,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Default: results/<name>.")
    ] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Continue an interrupted run, or extend a finished one."),
    ] = False,
    force: Force = False,
    processes: Processes = None,
) -> None:
    """MAP, sampling, diagnostics, tables and figures: the main job."""
    with guarded():
        from bayesdrill.basics.progress import reporter
        from bayesdrill.commands import pipeline
        from bayesdrill.engines.workers import available

        how = _mode(resume, force)
        job = pipeline.prepare(config)
        folder = output or Path("results") / job.config.name
        with saved_in(folder), reporter() as report:
            outcome = pipeline.posterior(job, folder, how, processes or available(), report)
        _finish(outcome)


@app.command(epilog="Example: bayesdrill calibrate configs/nominal_step.yaml")
def calibrate(
    config: ConfigPath,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Default: results/<name>-calibration.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with an interrupted calibration, or extend one.")
    ] = False,
    force: Force = False,
    processes: Processes = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Of a Dask cluster, such as tcp://host:8786."),
    ] = None,
) -> None:
    """Test the posterior of a config: refit simulated records, and see where the truth ranks."""
    with guarded():
        from bayesdrill.basics.progress import reporter
        from bayesdrill.commands import calibrate as calibration
        from bayesdrill.engines.workers import available
        from bayesdrill.insight.calibration import executors

        how = _mode(resume, force)
        job = calibration.prepare(config)
        folder = output or Path("results") / f"{job.config.name}-calibration"
        if scheduler is None:
            where = partial(executors.local, processes or available())
        else:
            where = partial(executors.dask, scheduler)
        with where() as crew, saved_in(folder), reporter() as report:
            outcome = calibration.calibrate(job, folder, how, crew, report)
        _finish_calibration(outcome)


@app.command(epilog="Example: bayesdrill report results/nominal_step")
def report(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of a finished run.")],
    processes: Processes = None,
) -> None:
    """Make tables and figures again from the stored chain."""
    with guarded():
        from bayesdrill.commands import pipeline
        from bayesdrill.engines.workers import available

        _finish(pipeline.republish(folder, processes or available()))


@app.command(epilog="Example: bayesdrill simulate configs/nominal_step.yaml --output my_record.csv")
def simulate(
    config: ConfigPath,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Default: the record that the config names."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Default: the config's.")] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Overwrite another simulated record.")
    ] = False,
) -> None:
    """Make a record from the config: exact response plus noise, as CSV."""
    with guarded():
        from bayesdrill.setup import loading, reading, simulating

        read, source = loading.load(config)
        record = reading.path_of(read, source)
        target = output or record
        text = simulating.simulate(read, source, read.seed if seed is None else seed, target)
        simulating.save(text, target, record, force=force)
        rows = len(text.splitlines()) - 1 - reading.csv_options(read.record).skip_rows
        typer.echo(f"{target}: {rows} samples")


@app.command(epilog="Example: bayesdrill paper --output results/paper")
def paper(
    configs: Annotated[
        Path, typer.Argument(metavar="[FOLDER]", help="With the configs of the studies.")
    ] = Path("configs/paper"),
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for tables and figures.")
    ] = Path("results/paper"),
    force: Force = False,
    processes: Processes = None,
) -> None:
    """Repeat the studies of the paper, each beside what a full posterior says of it (minutes)."""
    with guarded():
        from bayesdrill.basics.progress import reporter
        from bayesdrill.engines.workers import available
        from bayesdrill.paper.run import reproduce

        with saved_in(output, "start over with --force"), reporter() as report:
            done = reproduce(configs, output, processes or available(), report, force=force)
        typer.echo("\n".join(done.said))
        typer.echo(f"results: {done.folder}/ (report.md, tables, figures/, two posteriors)")
        if not done.converged:
            raise typer.Exit(NOT_CONVERGED)


@app.command(epilog="Example: bayesdrill schema > schema.json")
def schema() -> None:
    """Print the JSON schema of configs, for editors that complete and check them."""
    with guarded():
        from bayesdrill.setup.schema import as_text

        typer.echo(as_text(), nl=False)


def _mode(resume: bool, force: bool) -> Mode:
    from bayesdrill.basics.errors import InputError

    if resume and force:
        raise InputError.one("", "--resume and --force exclude each other; give one of them")
    return "resume" if resume else "force" if force else "fresh"


def _finish_calibration(outcome: Calibrated) -> None:
    from bayesdrill.report import calibration_words as words

    typer.echo(words.refits(outcome.verdict, outcome.refits))
    typer.echo("\n" + words.table(outcome.verdict))
    typer.echo(words.verdict(outcome.verdict))
    typer.echo(f"results: {outcome.folder}/ (summary.md, figures/, ranks.csv)")
    if not outcome.verdict.calibrated:
        raise typer.Exit(NOT_CONVERGED)


def _finish(outcome: Outcome) -> None:
    from bayesdrill.report import words

    typer.echo("\n\n".join((words.convergence(outcome.sampled), *outcome.shown)))
    typer.echo(f"results: {outcome.folder}/ (summary.md, figures/, posterior.nc, chain.h5)")
    for what in outcome.missing:
        typer.echo(f"could not be made: {what}", err=True)
    if outcome.missing:
        again = f"`bayesdrill report {outcome.folder}`"
        typer.echo(f"all else is written; once this is mended, {again} makes it", err=True)
    if outcome.reasons:
        raise typer.Exit(NOT_CONVERGED)
    if outcome.missing:
        raise typer.Exit(INPUT_WRONG)


def main() -> None:
    app()
