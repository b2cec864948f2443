"""Build a job from a config, in a file or in memory, and check the config against its record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.entries import entries_of
from bayesdrill.basics.errors import InputError, Issue, collect_each
from bayesdrill.config import loading
from bayesdrill.config.assembly.problem import build_problem
from bayesdrill.config.building.case import ResolvedCase
from bayesdrill.config.records import reading
from bayesdrill.config.records.sources import Files
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Source, as_yaml, parse
from bayesdrill.inference import derived, step_error
from bayesdrill.inference.posterior import Problem
from bayesdrill.output_files import RECORD
from bayesdrill.record.experiment import raise_if_any
from bayesdrill.record.formats.table import RecordTable
from bayesdrill.rig.models.linear import Model, constants
from bayesdrill.sampling.mode_search import Mode

# Largest rms of the residuals / sigma at the start. Above it, rounding hides improvements.
MAX_START_DISTANCE = 1e10


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """A job is a resolved case with its posterior; `files` holds the tables that were read.

    Only the first `samples` of longer records are used, or all if it is None.
    """

    case: ResolvedCase
    problem: Problem
    files: Files = field(default_factory=Files, compare=False, repr=False)
    samples: int | None = None

    @property
    def config(self) -> Config:
        """Return the config."""
        return self.case.config

    @property
    def source(self) -> Source:
        """Return the source of the config: its text, data and lines."""
        return self.case.source

    def with_settings(self, **changed: Any) -> Job:
        """Return the job with `changed` config sections, which must not affect the posterior."""
        config = self.config.model_copy(update=changed)
        return replace(self, case=replace(self.case, config=config))

    def with_data(self, data: Mapping[str, Any], text: str = "") -> Job:
        """Return the job with other entries but the same files; raises `InputError`.

        No file is read again, and unchanged entries are not validated again. An experiment keeps
        its record if the entries of the record are unchanged.
        """
        source = Source(self.source.path, text, data, {}, ())
        return assemble(loading.validate(source, self.case), self.files, self.samples)

    def first_samples(self, samples: int) -> Job:
        """Return the job with only the first `samples` of longer records."""
        return assemble(self.case, self.files, samples)

    def with_steps_at(self, mode: Mode) -> Job:
        """Return the job with the integration steps chosen at `mode`; linear rigs need none."""
        if not mode.pieces:
            return self
        posterior = step_error.with_steps(self.problem.posterior, mode.pieces)
        return replace(self, problem=replace(self.problem, posterior=posterior))


def prepare(path: Path) -> Job:
    """Load a config and its records, and build the job; raises `InputError` with all mistakes."""
    return assemble(loading.load(path))


def assemble(case: ResolvedCase, files: Files | None = None, samples: int | None = None) -> Job:
    """Read the records of a case, unless they are in `files`, and build the job; see `Job.samples`."""
    source, files = case.source, Files() if files is None else files
    records = collect_each(lambda resolved: reading.read(resolved, files), case.experiments)
    used = [record if samples is None else record.first(samples) for record in records]
    problem = build_problem(case, used)
    posterior = problem.posterior
    start = posterior.space.vector(posterior.space.start)
    if not np.isfinite(posterior.density(start[None])[0]):
        unsteady = _steady_start_issues(case, problem, start)
        message = "the model has no finite response at the start; check values and units"
        raise InputError(unsteady or [source.issue(("parameters",), message)])
    rms = float(posterior.likelihood.mean_square(start[None])[0]) ** 0.5
    if rms > MAX_START_DISTANCE:
        message = (
            f"the start is {rms:.2g} times the noise away from the record; check values and units"
        )
        raise source.error(("parameters",), message)
    if case.config.sampler.likelihood == "compressed":
        reasons = filter(None, (each.exact_reason for each in problem.observations))
        message = "a record cannot be compressed: {}; write `auto`, or omit this entry"
        raise_if_any([source.issue(("sampler", "likelihood"), message.format(r)) for r in reasons])
    impossible = derived.impossible_formulas(problem).items()
    raise_if_any([source.issue(("derived", name), text) for name, text in impossible])
    return Job(case=case, problem=problem, files=files, samples=samples)


def _steady_start_issues(case: ResolvedCase, problem: Problem, start: Array) -> list[Issue]:
    """Return an issue for each experiment with a steady start if the rig has no steady state."""
    full = problem.posterior.space.full(start[None])
    pairs = [(case.experiment(each.label), each) for each in problem.observations]
    unsteady = "the rig has no steady state at its parameters' start values and the first inputs"
    message = f"{unsteady}; give the initial state, or `free`"
    return [
        resolved.source.issue(("initial",), message)
        for resolved, observation in pairs
        if resolved.config.initial.state == "steady"
        and not np.isfinite(observation.signals(full)[0, 0]).any()
    ]


ARRAYS_PATH = Path("arrays")  # replaces the path of a config file in messages
TIME_COLUMN = "t"
MAX_DEPTH = 20  # levels of nested entries
MAX_INTEGER_BITS = 1000  # writing larger integers as text takes long


def job_in_memory(columns: Mapping[str, Array], entries: Mapping[str, Any]) -> Job:
    """Build a job from `columns (T,)`, of which `t` is time, and `entries`; raises `InputError`."""
    table = RecordTable(path=Path(RECORD), variables=dict(columns))
    record = {"file": RECORD, **entries.get("record", {})}
    record.setdefault("time", {"column": TIME_COLUMN, "unit": "s"})
    wrong: list[Issue] = []
    plain = _plain({**entries, "record": record}, (), wrong)
    raise_if_any(wrong)
    source = parse(ARRAYS_PATH, as_yaml(plain))
    source = replace(source, lines={})  # the user has not seen this text, so its lines mean nothing
    return assemble(loading.validate(source), Files(table))


def arrays_as_csv(columns: Mapping[str, Array]) -> str:
    """Return the columns as CSV text with all digits, so that reading it gives the same numbers."""
    lines = zip(*(values.tolist() for values in columns.values()), strict=True)
    return "\n".join([",".join(columns), *(",".join(map(repr, line)) for line in lines)]) + "\n"


def model_entry(rig: Model) -> dict[str, Any]:
    """Return the `model:` entry of a config that describes this rig."""
    entries, given = entries_of(type(rig)), constants(rig)
    plain = {
        name: TypeAdapter(kind).dump_python(given[name], warnings=False)
        for name, kind in entries.items()
        if name in given
    }
    return {"name": rig.name, **plain}


def _plain(value: Any, location: tuple[str, ...], issues: list[Issue]) -> Any:
    """Return a value as plain YAML data; add an issue if YAML cannot represent the value."""
    if len(location) > MAX_DEPTH:
        issues.append(Issue(".".join(location[:4]), "is nested too deep; see docs/config.md"))
        return None
    if isinstance(value, Mapping):
        items = [(str(key), item) for key, item in value.items()]
        return {key: _plain(item, (*location, key), issues) for key, item in items}
    if isinstance(value, list | tuple):
        return [_plain(item, (*location, str(k)), issues) for k, item in enumerate(value)]
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
        value = value.item()
    is_plain = value is None or isinstance(value, bool | float | str)
    if not is_plain and not (isinstance(value, int) and value.bit_length() < MAX_INTEGER_BITS):
        kind = "a number with that many digits" if isinstance(value, int) else type(value).__name__
        message = f"no entry can be {kind}; see docs/config.md for what it can be"
        issues.append(Issue(".".join(location), message))
    return value
