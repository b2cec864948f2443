"""Parse the command line, call the API and print the result; `guard` sets the exit status."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperGroup

import bayesdrill as bd
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.processes import available_processors, start_server
from bayesdrill.basics.progress import SILENT, reporter
from bayesdrill.guard import INPUT_WRONG, NOT_CONVERGED, finish, guarded, saved_in, say


class _Guarded(TyperGroup):
    """Run all commands; any error, also in `--help`, becomes a message and an exit status."""

    def make_context(self, *arguments: Any, **named: Any) -> Any:
        with guarded():
            return super().make_context(*arguments, **named)

    def invoke(self, ctx: Any) -> Any:
        with guarded():
            return super().invoke(ctx)


app = typer.Typer(
    cls=_Guarded,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Identify drive trains of inertias, shafts, gears, motors and servos from their records.",
)


def option(text: str, *names: str, **more: Any) -> Any:
    """Return an option with a help text; by default it has the name of the Python argument."""
    return typer.Option(*names, help=text.replace("[", r"\["), **more)  # [s] would be markup


def folder_argument(text: str, metavar: str = "FOLDER") -> Any:
    """Return a positional argument for files or folders, with a help text."""
    return typer.Argument(metavar=metavar, help=text)


def output_option(text: str) -> Any:
    """Return the option `--output` for a file or folder of results, with a help text."""
    return option(text, "--output", "-o")


ConfigPath = Annotated[Path, folder_argument("Experiment config (YAML).", "CONFIG")]
CampaignPath = Annotated[Path, folder_argument("Campaign file (YAML).", "CAMPAIGN")]
Force = Annotated[bool, option("Discard existing results and start over.", "--force")]
Scheduler = Annotated[
    str | None,
    option("Address of a Dask scheduler, such as tcp://host:8786.", metavar="ADDRESS"),
]
Processes = Annotated[
    int | None, option("Number of processes; the result does not depend on it.", min=1, max=256)
]


def command[F: Callable[..., None]](example: str, name: str | None = None) -> Callable[[F], F]:
    """Register a command, with an `example` of its use."""
    return app.command(name, epilog=f"Example: bayesdrill {example}")


def _tell_version(wanted: bool) -> None:
    """Print the version and stop; the option is eager, so no command has to follow."""
    if wanted:
        typer.echo(f"bayesdrill {bd.__version__}")
        raise typer.Exit


def _read(config: Path, read: str = "load", **more: Any) -> Any:
    """Read a config with the API function `read`; on a terminal, show which config is read."""
    watched = sys.stderr is not None and sys.stderr.isatty()
    with reporter() if watched else nullcontext(SILENT) as report:
        report.update(0.0, f"reading {config}")
        return getattr(bd, read)(config, **more)


def _run(
    read: str, config: Path, output: Path | None, /, arguments: Any = None, **options: Any
) -> Any:
    """Run a case, a calibration, a ladder or a campaign; if that fails, say how to continue.

    `arguments` has further arguments of the API function `read`, which reads the file.
    """
    if options["resume"] and options["force"]:
        from bayesdrill.api.arguments import mode

        mode(resume=True, force=True)  # raises an error before the record is read
    if (options["processes"] or available_processors()) > 1:
        with suppress(OSError):  # the pool of workers will report the error
            start_server()  # the server loads libraries while this process reads
    case = _read(config, read, **(arguments or {}))
    with saved_in(case.place(output)), reporter() as report:
        return case.run(output, report=report, **options)


def _compare(form: str, folders: list[Path], output: Path | None, *, force: bool) -> None:
    """Compare runs; `form` (`overlay` or `comparison`) is also the stem of the table files."""
    from bayesdrill.api import comparison

    path = comparison.check_folder(form, folders, output, force=force)
    result = (comparison.overlay if form == "overlay" else comparison.compare)(folders)
    result.save(path, force=force)
    files = f"report.html, {form}.md, {form}.csv, figures/"
    _end(result.text, path, files, good=not result.reasons)


def _end(text: str, folder: Path, files: str, *, good: bool) -> None:
    """Print the result and its folder, and set the exit status."""
    say(text)
    say(f"results: {folder}/ ({files})")
    if not good:
        raise typer.Exit(NOT_CONVERGED)


@app.callback()
def _top(
    _: Annotated[
        bool,
        typer.Option(
            "--version", callback=_tell_version, is_eager=True, help="Print the version and stop."
        ),
    ] = False,
) -> None:
    pass


@command("example my_rig")
def example(
    folder: Annotated[Path, folder_argument("Folder for the files; none is overwritten.")] = Path(
        "configs"
    ),
) -> None:
    """Write the example configs and records of the package into a folder."""
    say(str(bd.example(folder)))


@command("init configs/records/example_rig.csv --output my_rig.yaml")
def init(
    records: Annotated[list[Path], folder_argument("Files of the record.", "RECORD...")],
    output: Annotated[
        Path | None, output_option("The new config; default: next to the record.")
    ] = None,
    voltage: Annotated[
        float | None,
        option("The supply voltage, if it is constant and not recorded.", metavar="VOLTS"),
    ] = None,
    gear: Annotated[
        float | None, option("The reduction N of a gear N:1 between motor and shaft.", metavar="N")
    ] = None,
    rig: Annotated[str, option("The kind of rig.", metavar="NAME")] = "motor_shaft",
    columns: Annotated[
        list[str] | None,
        option('A column and its quantity, such as "data:3=theta_2 [deg]".', metavar="COLUMN=WHAT"),
    ] = None,
    rate: Annotated[
        float | None, option("The sampling rate, if no column has the time.", metavar="HZ")
    ] = None,
    sheet: Annotated[
        Path | None, option("A data sheet: a file with entries of `nominal:`.", metavar="YAML")
    ] = None,
    split: Annotated[
        bool, option("Begin a new record wherever the time decreases.", "--split")
    ] = False,
    force: Annotated[bool, option("Overwrite an existing config.", "--force")] = False,
) -> None:
    """Write a first config for records; each guess in the config is marked, with its reason."""
    known: dict[str, Any] = {"voltage": voltage, "gear": gear, "rate": rate, "sheet": sheet}
    known |= {"split": split, "force": force}
    say(str(bd.init(records, output, rig=rig, columns=columns or (), **known)))


@command("check configs/nominal_step.yaml")
def check(
    config: ConfigPath,
    figure: Annotated[
        Path | None, option("Draw the rig into this .pdf, .png or .svg file.", metavar="FILE")
    ] = None,
    figure_record: Annotated[
        Path | None, option("Draw the record over time into this file.", metavar="FILE")
    ] = None,
) -> None:
    """Validate a config and its record, or a campaign, and describe the run, without sampling."""
    from bayesdrill.api.campaign import is_campaign

    if is_campaign(config):
        if figure or figure_record:
            message = "a campaign has no such figure; give this option with its base config"
            raise InputError.at(str(config), message)
        with reporter() as report:
            preview = bd.campaign(config).preview(report)
        say(preview)
        return
    case = _read(config)
    say(case.preview())
    for draw, file in ((case.draw_rig, figure), (case.draw_record, figure_record)):
        if file is not None:
            say(draw(file))


@command("identify configs/nominal_step.yaml --profile k_s")
def identify(
    config: ConfigPath,
    profile: Annotated[
        list[str] | None,
        option("Compute the profile of a parameter, or of `all`.", "--profile", metavar="NAME"),
    ] = None,
    at_map: Annotated[
        bool,
        option("Search the MAP, and evaluate there; default: at the start values.", "--at-map"),
    ] = False,
    output: Annotated[
        Path | None, output_option("Folder for text and figures; default: print only.")
    ] = None,
    force: Annotated[
        bool, option("Overwrite text and figures of an earlier `identify`.", "--force")
    ] = False,
    processes: Processes = None,
) -> None:
    """Predict what a record can and cannot determine, and what would help, without sampling."""
    case = _read(config)
    if output is not None:
        case.check_place(output, force=force)
    with reporter() as report:
        at = case.find_map(processes=processes, report=report) if at_map else None
        findings = case.identify(profile or [], at=at, report=report)
    say(findings.text)
    if output is not None:
        say("\nwritten: " + findings.save(output, force=force))
    if findings.reasons:
        raise typer.Exit(NOT_CONVERGED)


@command("design configs/nominal_step.yaml --high 12 --limit w_2=0: --output next")
def design(
    source: Annotated[Path, folder_argument("A config, or the folder of a run.", "CONFIG|RUN")],
    learn: Annotated[
        str,
        option(
            "Parameters or formulas to learn, separated by commas; default: all possible.",
            metavar="NAMES",
        ),
    ] = "",
    tell: Annotated[
        Path | None,
        option(
            "A second config; the experiment is to distinguish its model from that of the first.",
            metavar="CONFIG",
        ),
    ] = None,
    drive: Annotated[str | None, option("The input to design.", "--input", metavar="NAME")] = None,
    low: Annotated[float | None, option("Lowest level, SI; default: the record's, or 0.")] = None,
    high: Annotated[float | None, option("Highest level, SI; default: the record's, or 0.")] = None,
    hold: Annotated[
        float | None, option("Duration of a level [s]; default: 1/40 of the total.")
    ] = None,
    duration: Annotated[float | None, option("Total duration [s]; default: the record's.")] = None,
    rate: Annotated[
        float | None, option("Sampling rate [Hz]; default: that of the record.")
    ] = None,
    slew: Annotated[float | None, option("Largest rate of change, SI per s.")] = None,
    limit: Annotated[
        list[str] | None,
        option(
            "Limits of a formula (SI), such as w_2=0: or 'integral(r_m*i**2)=:50'.",
            metavar="FORMULA=LOW:HIGH",
        ),
    ] = None,
    family: Annotated[
        str | None,
        option(
            "Kind of waveform: free, step, prbs, chirp, multisine, steps or coast.", metavar="NAME"
        ),
    ] = None,
    experiments: Annotated[int, option("The number of experiments to design.", min=1, max=9)] = 1,
    draws: Annotated[
        int, option("Number of draws over which the design is averaged.", min=1, max=64)
    ] = 8,
    output: Annotated[
        Path | None, output_option("Folder for waveform, config and figure; default: print only.")
    ] = None,
    force: Annotated[bool, option("Overwrite an earlier design.", "--force")] = False,
) -> None:
    """Design the next experiment: the best waveform within limits, and the sds to expect."""
    planner = bd.open(source) if source.is_dir() else _read(source)
    if output is not None:
        planner.check_design_place(output, force=force)
    other = None if tell is None else _read(tell)
    names = [name for name in learn.split(",") if name.strip()]
    numbers = {"low": low, "high": high, "hold": hold, "duration": duration, "rate": rate}
    with reporter() as report:
        designed = planner.design(
            names, input=drive, slew=slew, limits=limit or [], family=family, draws=draws,
            experiments=experiments,
            tell=other, report=report, **numbers,
        )  # fmt: skip
    say(designed.text)
    if output is not None:
        say("\nwritten: " + designed.save(output, force=force))


@command("map configs/nominal_step.yaml", "map")
def map_(
    config: ConfigPath,
    output: Annotated[
        Path | None, output_option("Folder for values, prediction and fit; default: none.")
    ] = None,
    force: Force = False,
    quick: Annotated[
        bool, option("Search once, and do not look for causes of a bad fit.", "--quick")
    ] = False,
    apply: Annotated[
        Path | None,
        option("Write a new config with the recommended lines.", "--apply", metavar="NEW"),
    ] = None,
    processes: Processes = None,
) -> None:
    """Find the maximum of the posterior (MAP), print it, and rank possible causes of a bad fit."""
    if quick and apply is not None:
        raise InputError.at("--apply", "needs the candidates that --quick leaves out")
    case = _read(config)
    if output is not None:
        bd.Best.check_place(output, force=force)
    if apply is not None:
        case.check_new_config(apply, force=force)
    with reporter() as report:
        best = case.find_map(quick=quick, processes=processes, report=report)
    say(best.table)
    believable = not best.reasons
    if not quick:
        with reporter() as report:
            candidates = best.candidates(processes=processes, report=report)
        if candidates.table:
            say(candidates.table)
        cause = candidates.recommended
        believable &= cause is None or not cause.off_by_a_factor
        if apply is not None:
            written = candidates.apply(apply, force=force)
            why = "" if candidates.table else ": the residuals look like the noise"
            say(f"{written}: written" if written else f"{apply}: nothing to write{why}")
    if output is not None:
        path = best.save(output, force=force)
        say(f"results: {path}/ (report.html, map.md, prediction*.csv, figures/)")
    if not believable:
        raise typer.Exit(NOT_CONVERGED)


@command("posterior configs/nominal_step.yaml --output results/mine")
def posterior(
    config: ConfigPath,
    output: Annotated[Path | None, output_option("Default: results/<name>.")] = None,
    resume: Annotated[
        bool, option("Continue an interrupted run, or extend a finished one.", "--resume")
    ] = False,
    force: Force = False,
    processes: Processes = None,
    verbose: Annotated[bool, option("Print the whole report.", "--verbose")] = False,
) -> None:
    """Search the MAP, sample the posterior, and write diagnostics, tables and figures."""
    options = {"resume": resume, "force": force, "processes": processes, "verbose": verbose}
    finish(_run("load", config, output, **options), verbose=verbose)


@command("calibrate configs/nominal_step.yaml")
def calibrate(
    config: ConfigPath,
    output: Annotated[Path | None, output_option("Default: results/<name>-calibration.")] = None,
    resume: Annotated[
        bool, option("Continue an interrupted calibration, or extend a finished one.", "--resume")
    ] = False,
    force: Force = False,
    processes: Processes = None,
    scheduler: Scheduler = None,
) -> None:
    """Test the posterior of a config: refit simulated records, and rank true values among draws."""
    options = {"resume": resume, "force": force, "processes": processes, "scheduler": scheduler}
    done = _run("calibration", config, output, **options)
    files = "report.html, summary.md, figures/, ranks.csv"
    _end(done.summary, done.folder, files, good=done.verdict.calibrated)


@command("report results/nominal_step")
def report(
    folders: Annotated[
        list[Path], folder_argument("The folders of one or several finished runs.", "FOLDER...")
    ],
    output: Annotated[
        Path | None,
        output_option("Default: the folder of the run; for several runs, results/<name>-<name>."),
    ] = None,
    force: Force = False,
    pdf: Annotated[
        bool, option("Write every figure of a run as PDF too, not only corner plots.", "--pdf")
    ] = False,
    processes: Processes = None,
) -> None:
    """Make the tables and figures of a stored chain again, or overlay several runs."""
    if len(folders) > 1:
        _compare("overlay", folders, output, force=force)
        return
    with reporter() as progress:
        outcome = bd.publish(
            folders[0], output, force=force, processes=processes, pdf=pdf, report=progress
        )
    finish(outcome)


@command("compare results/nominal_step results/damped")
def compare(
    folders: Annotated[
        list[Path],
        folder_argument("The folders of two or more finished runs of one record.", "FOLDER..."),
    ],
    output: Annotated[Path | None, output_option("Default: results/compare-<name>-<name>.")] = None,
    force: Force = False,
) -> None:
    """Say which model of a record is more probable, and whether rig or noise is the reason."""
    _compare("comparison", folders, output, force=force)


@command("ladder configs/nominal_step.yaml")
def ladder(
    config: ConfigPath,
    output: Annotated[Path | None, output_option("Default: results/<name>-ladder.")] = None,
    sample: Annotated[int, option("The number of best candidates to sample.", min=2, max=9)] = 2,
    resume: Annotated[bool, option("Continue an interrupted ladder.", "--resume")] = False,
    force: Force = False,
    processes: Processes = None,
    scheduler: Scheduler = None,
) -> None:
    """Rank possible changes of a config, sample and compare the best, and recommend a config."""
    options = {"resume": resume, "force": force, "processes": processes, "scheduler": scheduler}
    done = _run("ladder", config, output, {"sample": sample}, **options)
    files = "report.html, comparison.md, recommended.yaml, ..."
    _end(done.summary, done.folder, files, good=not done.report.reasons)


@command("campaign configs/campaign/shaft.yaml")
def campaign(
    campaign: CampaignPath,
    output: Annotated[Path | None, output_option("Default: results/<name>.")] = None,
    resume: Annotated[
        bool, option("Continue an interrupted campaign, or add new runs.", "--resume")
    ] = False,
    force: Force = False,
    seed: Annotated[int | None, option("Random seed; default: the campaign's.", min=0)] = None,
    page: Annotated[
        list[str] | None,
        option("Write the page of a run, or of all `outliers`; implies --resume.", metavar="RUN"),
    ] = None,
    processes: Processes = None,
    scheduler: Scheduler = None,
) -> None:
    """Fit many runs of a config, each alone, and then their population: spread, drift, outliers."""
    resume |= page is not None and not force
    options = {"resume": resume, "force": force, "processes": processes, "scheduler": scheduler}
    done = _run("campaign", campaign, output, {"seed": seed, "pages": page or ()}, **options)
    files = "report.html, summary.md, population.csv, runs.parquet, ..."
    _end(done.summary, done.folder, files, good=not done.reasons)


@command("watch configs/campaign/shaft.yaml --once")
def watch(
    campaign: CampaignPath,
    output: Annotated[Path | None, output_option("Default: results/<name>.")] = None,
    once: Annotated[
        bool, option("Check for new files once and stop, such as for cron.", "--once")
    ] = False,
    interval: Annotated[float, option("Seconds between two checks for new files.", min=0.1)] = 10.0,
    processes: Processes = None,
    scheduler: Scheduler = None,
) -> None:
    """Add new runs to a campaign as their files arrive; alarms are lines of JSON on stdout."""
    options: dict[str, Any] = {"processes": processes, "scheduler": scheduler}
    with reporter() as report:
        alarms = bd.watch(campaign, output, once=once, interval=interval, report=report, **options)
        for alarm in alarms:
            typer.echo(alarm)


@command("verify results/nominal_step")
def verify(folder: Annotated[Path, folder_argument("Folder of a finished run.")]) -> None:
    """Verify that config, record, tables and figures of a run still belong together."""
    verification = bd.verify(folder)
    say(verification.summary, err=not verification.together)
    if not verification.together:
        raise typer.Exit(INPUT_WRONG)


@command("simulate configs/nominal_step.yaml --output my_record.csv")
def simulate(
    config: ConfigPath,
    output: Annotated[
        Path | None, output_option("Default: the record that the config names.")
    ] = None,
    seed: Annotated[int | None, option("Random seed; default: the config's.", min=0)] = None,
    force: Annotated[bool, option("Overwrite simulated records.", "--force")] = False,
) -> None:
    """Simulate the record of a config or all records of a campaign: response plus noise, as CSV."""
    simulated = bd.simulate(config, output, seed=seed, force=force)
    say(simulated.said)


@command("schema > schema.json")
def schema(
    of: Annotated[
        Literal["config", "campaign", "run"],
        option("The schema of configs, of campaigns, or of a posterior's run.json.", "--of"),
    ] = "config",
) -> None:
    """Print the JSON schema of configs or campaigns, for editors that complete and check them."""
    typer.echo(bd.schema(of), nl=False)


@command("export results/nominal_step --to mjcf --output rig.xml")
def export(
    folder: Annotated[Path, folder_argument("Folder of a finished run.")],
    to: Annotated[
        Literal["json", "mjcf", "dcmotor"],
        option("JSON, MJCF (MuJoCo), or MJCF with MuJoCo's own motors (3.5 and newer).", "--to"),
    ],
    output: Annotated[Path | None, output_option("Default: print to stdout.")] = None,
    draws: Annotated[int, option("Upper limit of posterior draws.", min=2, max=100_000)] = 100,
    force: Annotated[bool, option("Overwrite an existing file.", "--force")] = False,
) -> None:
    """Export the rig to simulators: armatures, damping and friction, with their sds and draws."""
    text = bd.export(folder, to, output, draws=draws, force=force)
    typer.echo(text if output is None else f"{output}: written", nl=output is not None)


@command("cite")
def cite() -> None:
    """Print BibTeX entries of bayesdrill and of the works on which a result is based."""
    say(bd.citation().rstrip("\n"))


@command("cache --clear")
def cache(clear: Annotated[bool, option("Remove all kernels.", "--clear")] = False) -> None:
    """Print the folder of compiled kernels, which later commands use again, and its size."""
    from bayesdrill.api import files

    say(files.cache(clear=clear))


def main() -> None:
    """Run the command that the arguments of this process name."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # file names may not be valid Unicode
            stream.reconfigure(errors="backslashreplace")
    command = typer.main.get_command(app)
    for option in command.params:
        if option.name == "show_completion":
            option.hidden = True  # type: ignore[attr-defined]
    command()
