"""Work on files and folders: examples, draft configs, reports, exports, calibration, schemas."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bayesdrill import output_files
from bayesdrill.api import arguments
from bayesdrill.api.arguments import ManyFits
from bayesdrill.basics import software as citing
from bayesdrill.basics.equality import Value
from bayesdrill.basics.errors import InputError, Issue, collect_each, count_noun, short_repr
from bayesdrill.basics.progress import SILENT, Reporter

if TYPE_CHECKING:
    from bayesdrill.config.job import Job
    from bayesdrill.drafting.draft import Guess
    from bayesdrill.results.run_folder import WriteMode
    from bayesdrill.tasks.calibrate import CalibrationOutcome as Calibrated
    from bayesdrill.tasks.pipeline import Outcome
    from bayesdrill.tasks.remote import RefitExecutor
    from bayesdrill.tasks.verify import Verified


PACKAGE = Path(__file__).parents[1]
FILES = (
    *("nominal_step.yaml", "example_rig.yaml", "example_ties.yaml", "example_experiments.yaml"),
    *("example_torque.yaml", "example_servo.yaml", "schema.json"),
    *(f"records/{name}.csv" for name in ("nominal_step", "example_rig", "example_ties")),
    *(f"records/{name}.csv" for name in ("example_step", "example_rundown", "example_torque")),
    "records/example_servo.csv",
    *("campaign/base.yaml", "campaign/shaft.yaml", "campaign/runs/runs.csv"),
    *("campaign/runs/truth.csv", *(f"campaign/runs/run_{k:02d}.csv" for k in range(1, 13))),
)


def _bundled() -> Path:
    """Return the folder of the examples: `examples` in a wheel, or `configs` in a checkout."""
    for path in (PACKAGE / "examples", PACKAGE.parent / "configs"):
        if (path / FILES[0]).is_file():
            return path
    raise InputError.at(str(PACKAGE), "has no examples; install bayesdrill again")


def _in_the_way(folder: Path, paths: Iterable[Path]) -> list[Issue]:
    """Return an issue for a file where a folder is needed, and for each example that exists."""
    records = folder / "records"
    wrong = [] if output_files.path_kind(records) in ("", "a folder") else [records]
    if folder.exists() and not folder.is_dir():
        wrong = [folder]
    no_folder = "is not a folder, but the examples need one here"
    obstacles = [(path, no_folder) for path in wrong]
    obstacles += [(path, "is there already") for path in paths if output_files.path_kind(path)]
    return [Issue(str(path), f"{why}; move it, or give another FOLDER") for path, why in obstacles]


@dataclass(frozen=True, slots=True)
class Example:
    """An example has the files that `bd.example` wrote; `print` shows a command to try."""

    folder: Path
    files: tuple[Path, ...]

    def __str__(self) -> str:
        return (
            f"{self.folder}/: configs with their records, to run and to copy; try\n"
            f"  bayesdrill check {shlex.quote(str(self.files[0]))}"
        )

    __repr__ = __str__


@arguments.check_arguments
def example(folder: str | Path = "configs") -> Example:
    """Write the configs and records of the examples into a folder; nothing is overwritten.

    Parameters
    ----------
    folder : str or path
        The folder, which is made if needed.

    Returns
    -------
    Example
        The folder and its files.

    Raises
    ------
    InputError
        With all files that exist already; nothing is written in this case.

    Examples
    --------
    >>> bd.example("examples").files[0].name
    'nominal_step.yaml'
    """
    target, bundled = Path(folder).expanduser(), _bundled()
    contents = {target / name: (bundled / name).read_bytes() for name in FILES}
    if obstacles := _in_the_way(target, contents):
        raise InputError(obstacles)
    for path, content in contents.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        output_files.write(path, content)
    return Example(target, tuple(contents))


def citation() -> str:
    """Return BibTeX entries for bayesdrill and for the publications of its methods.

    Returns
    -------
    str
        The text of a .bib file.

    Examples
    --------
    >>> bd.citation().count("@") > 1
    True
    """
    return citing.citation()


@arguments.check_arguments
def init(
    record: str | Path | Sequence[str | Path],
    output: str | Path | None = None,
    *,
    voltage: float | None = None,
    gear: float | None = None,
    rig: str = "motor_shaft",
    columns: Sequence[str] = (),
    rate: float | None = None,
    sheet: str | Path | None = None,
    split: bool = False,
    force: bool = False,
) -> Guess:
    """Draft a config for a record; a comment with REVIEW gives the reason of each guess.

    Files with the same columns become experiments of one config.  Files with different columns are
    joined to one record by their times.

    Parameters
    ----------
    record : str, path or sequence of str or path
        The files of the record.
    output : str or path, optional
        The config to write, by default next to the first file.
    voltage : float, optional
        The constant voltage of the motor in V, if no column has the voltage.
    gear : float, optional
        The gear ratio: turns of the motor / turns of the shaft.
    rig : str
        The name of the rig.
    columns : sequence of str
        Quantities of columns: `data:3=theta_2 [deg]` is column 3 of the array `data`.
    rate : float, optional
        The sampling rate in Hz, if no column has the time.
    sheet : str or path, optional
        A YAML file with nominal values.
    split : bool
        Whether a new experiment begins wherever the time decreases.
    force : bool
        Whether to replace an existing config.

    Returns
    -------
    Guess
        The text of the config, and the issues that only the user can correct.

    Raises
    ------
    InputError
        If a file cannot be read, or the files cannot be combined.

    Examples
    --------
    >>> "REVIEW" in bd.init("configs/records/nominal_step.csv", "draft.yaml", voltage=8.0).text
    True
    """
    from bayesdrill.config import yaml_source
    from bayesdrill.drafting import draft, record_files
    from bayesdrill.drafting.columns import named_column
    from bayesdrill.report.findings import finding_sentences
    from bayesdrill.rig.models import MODELS

    limits = {"voltage": (voltage, -1e6, 1e6), "gear": (gear, 1, 1e6), "rate": (rate, 1e-6, 1e9)}
    for name, (value, least, most) in limits.items():
        if value is not None and not (least <= value <= most):
            message = f"{short_repr(value)} is not a number from {least:g} to {most:g}; write one, "
            raise InputError.at(name, message + "such as 8 for a gear of 8:1, or leave it out")
    given = [record] if isinstance(record, str | Path) else record
    records = [Path(path).expanduser() for path in given]
    if not records:
        raise InputError.at("record", "no file is named; name one or several")
    files = [path.name for path in records]
    known = record_files.GivenFacts(
        rig=arguments.known(MODELS, rig, "rig", "rig")(),
        gear=gear,
        voltage=voltage,
        rate=rate or 0.0,
        columns=tuple(collect_each(lambda text: named_column(text, files), columns)),
        has_several=split,
    )
    stem = record_files.common_stem(records) if len(records) > 1 else records[0].stem
    target = arguments.results_folder(output, records[0].parent / f"{stem}.yaml")
    read = records if sheet is None else [*records, Path(sheet).expanduser()]
    draft.check_draft_path(target, read, force=force)
    values = None if sheet is None else yaml_source.read(read[-1])
    if values is not None and values.repeated:
        raise InputError(values.repeated)
    drafted = draft.guess(records, target, known, values, finding_sentences)
    draft.check_draft_path(target, read, force=force)  # again, since drafting took some time
    output_files.write_text(target, drafted.text)
    return drafted


@arguments.check_arguments
def publish(
    folder: str | Path,
    output: str | Path | None = None,
    *,
    force: bool = False,
    processes: int | None = 1,
    pdf: bool = False,
    report: Reporter | None = None,
) -> Outcome:
    """Make the tables and figures of a run anew from its chain, like `bayesdrill report`.

    Parameters
    ----------
    folder : str or path
        The folder of the run.
    output : str or path, optional
        A folder for a copy of the run with the new results; by default `folder` is changed.
    force : bool
        Whether to replace earlier results in `output`.
    processes, report
        See `Case.sample`.
    pdf : bool
        Whether to write figures as PDF, too.

    Returns
    -------
    Outcome
        The folder, the reasons not to believe the run, and the results that could not be made.

    Raises
    ------
    InputError
        If `folder` has no run.

    Examples
    --------
    >>> bd.publish(run.save("results/mine")).missing
    ()
    """
    from bayesdrill.tasks import pipeline

    source, workers = Path(folder).expanduser(), arguments.workers(processes)
    path = arguments.results_folder(output, source)
    if output is not None:
        pipeline.copy_result(source, path, force=force)
    elif force:
        message = "needs --output or several folders; for a single folder, results are replaced"
        raise InputError.at("--force", message)
    return pipeline.republish(path, workers, report or SILENT, pdf=pdf)


@arguments.check_arguments
def verify(folder: str | Path) -> Verified:
    """Check by digests that the config, record, chain, tables and figures of a run are unchanged.

    Parameters
    ----------
    folder : str or path
        The folder of the run.

    Returns
    -------
    Verified
        The files that changed, with reasons; `print` shows them.

    Raises
    ------
    InputError
        If `folder` has no finished run.

    Examples
    --------
    >>> bd.verify(run.save("results/mine")).together
    True
    """
    from bayesdrill.tasks import verify as verifying

    return verifying.verify(Path(folder).expanduser())


@arguments.check_arguments
def export(
    folder: str | Path,
    to: str = "json",
    output: str | Path | None = None,
    *,
    draws: int = 100,
    seed: int = 0,
    force: bool = False,
) -> str:
    """Export the rig of a run for a simulator, with posterior means as its parameters.

    The export describes springs, motors, and the armature, damping and dry friction of each joint.
    Each number has its standard deviation.  JSON also has correlations, and draws to vary the rig.

    Parameters
    ----------
    folder : str or path
        The folder of the run.
    to : {"json", "mjcf", "dcmotor"}
        The format: JSON, MJCF (MuJoCo), or MJCF with `dcmotor` actuators (MuJoCo 3.5 or later).
    output : str or path, optional
        A file to which the text is written, too.
    draws, seed : int
        The number of draws in JSON, and the seed of their random selection.
    force : bool
        Whether to replace an existing file.

    Returns
    -------
    str
        The exported text.

    Raises
    ------
    InputError
        If `folder` has no finished run, or `output` cannot be written.

    Examples
    --------
    >>> folder = run.save("results/mine")
    >>> bd.export(folder, "mjcf").startswith("<")
    True
    """
    import numpy as np

    from bayesdrill.config.records import sources
    from bayesdrill.tasks import export as exporting
    from bayesdrill.tasks import pipeline

    write = arguments.known(exporting.FORMS, to, "to", "form")
    count = arguments.integer("draws", draws, 2)
    target = None if output is None else Path(output).expanduser()
    place = Path(folder).expanduser()
    if target is not None:
        output_files.refuse_other_than_file(target)
        read = (place / name for name in output_files.output_names(place, output_files.POSTERIOR))
        output_files.refuse_existing(target, read, force=force)
    run = pipeline.read_result(place)
    rng = np.random.default_rng(seed)
    text = write(exporting.simulator_model(run, count, rng))
    if target is not None:
        output_files.refuse_replacing(sources.files(run.job.case), [target])
        output_files.write_text(target, text)
    return text


@arguments.check_arguments
@dataclass(frozen=True, slots=True, eq=False)
class Calibration(ManyFits["Calibrated"], Value):
    """A calibration tests the posterior by fits to records that are simulated from the prior.

    `bd.calibration` makes one.  If posteriors are computed correctly, the ranks of true values
    among the draws are uniformly distributed (simulation-based calibration, Talts et al. 2018).

    Parameters
    ----------
    job : Job
        The config.
    """

    job: Job

    kind: ClassVar[str] = "calibration"

    def _run(self, path: Path, how: WriteMode, crew: RefitExecutor, report: Reporter) -> Calibrated:
        from bayesdrill.tasks import calibrate

        return calibrate.calibrate(self.job, path, how, crew, report)


@arguments.check_arguments
def calibration(config: str | Path) -> Calibration:
    """Prepare the calibration test of a config; `Calibration.run` does the work.

    Parameters
    ----------
    config : str or path
        The config.  It needs no record if its section `simulation:` gives the times.

    Returns
    -------
    Calibration
        The test, before any fit.

    Raises
    ------
    InputError
        With all mistakes in the config.

    Examples
    --------
    >>> bd.calibration("configs/nominal_step.yaml").place().name
    'nominal_step-calibration'
    """
    from bayesdrill.tasks.calibrate import prepare

    return Calibration(prepare(Path(config).expanduser()))


@arguments.check_arguments
def schema(of: str = "config") -> str:
    """Return the JSON schema of a kind of file.

    Parameters
    ----------
    of : {"config", "campaign", "run"}
        The kind of file: a config, a campaign, or the `run.json` of a run.

    Returns
    -------
    str
        The schema as a JSON text.

    Raises
    ------
    InputError
        If `of` is not one of these kinds.

    Examples
    --------
    >>> bd.schema().startswith("{")
    True
    """
    from bayesdrill.config.schema.json_schema import campaign_schema, json_schema
    from bayesdrill.tasks.run_entries import run_schema

    schemas = {"config": json_schema, "campaign": campaign_schema, "run": run_schema}
    return arguments.known(schemas, of, "of", "schema")()


@arguments.check_arguments
def cache(*, clear: bool = False) -> str:
    """Describe the cache of compiled kernels: its folder, the number of kernels, and its size.

    Parameters
    ----------
    clear : bool
        Whether to remove all kernels first.

    Returns
    -------
    str
        A line with the folder, or with the reason why kernels are not kept.

    Raises
    ------
    InputError
        If other users have access to the folder, or it cannot be read or cleared.
    """
    from bayesdrill.rig.kernels.cache import CACHE_OFF, CACHE_VARIABLE, user_cache

    user = user_cache()
    if user.folder is None:
        return f"compiled kernels are not kept: {CACHE_VARIABLE}={CACHE_OFF}"
    try:
        if clear:
            user.clear()
        sizes = user.sizes
    except OSError as error:
        reason = error.strerror or str(error)
        message = f"{reason}; correct this, or name another folder by {CACHE_VARIABLE}"
        raise InputError.at(str(user.folder), message) from None
    return f"{user.folder}: {count_noun(len(sizes), 'compiled kernel')}, {sum(sizes) / 1e6:.1f} MB"
