"""From the files of records to a config that runs, every guess with its reason, or to why none can
be made.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bayesdrill import output_files
from bayesdrill.basics import symbols
from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.config import loading
from bayesdrill.config.job import assemble
from bayesdrill.config.records import sources
from bayesdrill.config.yaml_source import parse
from bayesdrill.drafting import entries, record_files, roles
from bayesdrill.drafting.entries import REVIEW, Found, comment, review, scalar
from bayesdrill.drafting.record_files import Experiment
from bayesdrill.drafting.roles import Start

SPREAD = 1.0  # of the logarithm of a parameter: nobody has said anything of this rig
DAMPING = 0.01  # N m s/rad, which adds 6 % of the critical damping to the paper's rig
FRICTION = 0.1  # N m, as much as the paper's motor has


def page(found: Found, name: str) -> str:
    lead = found.lead.of
    every = [found.name(one.of.path) for one in found.every]
    lines = [
        *comment(
            f"A first config of {', '.join(every)}, by `bayesdrill init`. What was guessed stands below "
            "a line with REVIEW and its reason: look at each, mend it or not, and take the line away."
        ),
        "",
        f"name: {scalar(name)}",
        "seed: 1                 # any whole number; the same seed gives the same result",
        "",
        *entries.record_entries(found),
        "",
        *entries.input_entries(found),
        *(_experiments(found) if found.several else _initial(found.starts[found.lead.label])),
        "",
        *review([lead.found.gear_doubt], 0),
        *(
            comment(f"gear {lead.found.gear:.6g}:1, {lead.found.gear_why}")
            if lead.found.gear_why
            else ()
        ),
        f"model: {{name: motor_shaft, i_m: {1 / lead.found.gear:.6g}}}",
        "",
        *_parameters(
            turns_back=any(roles.both_ways(one.of.found) for one in found.every),
        ),
    ]
    return "\n".join(lines) + "\n"


def _initial(start: Start) -> list[str]:
    entry = _state(start)
    if entry:
        return ["", *review(start.doubts, 0), f"initial: {entry}"]
    where = "" if start.window is None else " where the window begins"
    what = "At rest" if start.zeros else "At rest, at angle zero"
    return ["", *comment(f"{what}{where}: nothing to say in `initial:`")]


def _state(start: Start) -> str:
    """The entry `initial:`, empty where it has nothing to say."""
    time = [] if start.time is None else [f"time: {start.time:.12g}"]
    state = [f"state: {start.state}"] if start.state else []
    named = [*time, *state, *([start.angle] if start.angle else [])]
    if named == state:
        return start.state
    return f"{{{', '.join(named)}}}"


def _experiments(found: Found) -> list[str]:
    lines = ["", *comment("Each has its file, and what is its own; all else is as above.")]
    lines.append("experiments:")
    for one in found.every:
        lines += _experiment(found, one)
    doubt = (
        "the same sensors in each: one noise, one offset, one lag; take out what differs, and it is "
        "an unknown of each experiment"
    )
    return [*lines, "", *review([doubt], 0), f"shared: [{', '.join(_shared(found))}]"]


def _experiment(found: Found, one: Experiment) -> list[str]:
    start = found.starts[one.label]
    record = [f"file: {scalar(found.name(one.of.path))}"]
    doubts = [*([start.window_doubt] if start.window else []), *start.doubts]
    if start.window is not None:
        record.append(f"window: {entries.span(start)}")
    sections = [f"record: {{{', '.join(record)}}}"]
    own = _own_inputs(found, one)
    if own:
        sections.append(f"inputs: {{{own}}}")
    if entry := _state(start):
        sections.append(f"initial: {entry}")
    head, whole = review(doubts, 2), f"  {scalar(one.label)}: {{{', '.join(sections)}}}"
    if len(whole) <= 110:
        return [*head, whole]
    return [*head, f"  {scalar(one.label)}:", *(f"    {section}" for section in sections)]


def _own_inputs(found: Found, one: Experiment) -> str:
    if one.inputs is not None:
        file = scalar(found.name(one.inputs.path))
        held = [name for name in ("v", "t_1") if getattr(one.inputs.found, name) is not None]
        return ", ".join(f"{name}: {{file: {file}}}" for name in held)
    known = entries.constant_input(found)
    return f"v: {known[one.label]}" if len({*known.values()}) > 1 else ""


def _shared(found: Found) -> list[str]:
    """Unknowns of the sensors; moments of steps that are given by hand are not."""
    v = found.lead.of.found.v
    names = ["t_0"] if found.measured else []
    if found.voltage is None and v is not None and not entries.constant_input(found):
        names.append("offset_v")
    if found.lag is not None:
        names.append(f"lag_{found.lag.of}")
    return [*names, *(f"sigma_{one.name}" for one in found.channels if not one.derived)]


def _parameters(*, turns_back: bool) -> list[str]:
    """`turns_back`: driven in both directions."""
    table = symbols.NOMINAL[symbols.DEFAULT_NOMINAL].values
    lines = [
        *review(
            ["this is the paper's rig; write what your data sheets say, and how far it may be off"],
            0,
        ),
        "nominal:",
        f"  table: {symbols.DEFAULT_NOMINAL}",
        "  tolerance: 0.2",
        *(_with_meaning(f"  {name}: {value:.4g}", 16, name) for name, value in table.items()),
        "",
        *comment("A prior, a number that holds it, or `nominal`. Factors of the nominal value:"),
        *review(
            [
                "wide, as nothing is known: one standard deviation is a factor of "
                f"{2.718281828**SPREAD:.2g}. Hold what you have weighed or measured"
            ],
            0,
        ),
        "parameters:",
    ]
    for name in table:
        if name == "t_f" and turns_back:
            doubt = (
                "it keeps its sign, and this rig turns both ways: held at zero, and c_m stands for all "
                "friction"
            )
            lines += [*review([doubt], 2), "  t_f: 0.0"]
        else:
            prior = f"{{prior: log_normal, median: 1, sd_log: {SPREAD:g}, relative: true}}"
            lines.append(f"  {name}: {prior}")
    return [*lines, *_more(turns_back=turns_back)]


def _more(*, turns_back: bool) -> list[str]:
    """Physics that is off: lines that need only lose their sign."""
    shown = {"c_s": DAMPING} | ({"t_cm": FRICTION} if turns_back else {})
    which = "damping and friction are" if turns_back else "damping is"
    lines = comment(
        f"Further {which} switched on by naming it, see docs/rigs.md; take the # away:", 2
    )
    for name, scale in shown.items():
        entry = f"  # {name}: {{prior: half_normal, scale: {scale:g}}}"
        lines.append(_with_meaning(entry, 48, name))
    return lines


def _with_meaning(entry: str, width: int, name: str) -> str:
    """An entry for the parameter `name`, and what that is."""
    symbol = symbols.PARAMETERS[name]
    return f"{entry:<{width}}# {symbol.plain_unit}, {symbol.meaning}"


@dataclass(frozen=True, slots=True)
class Guess:
    """`text` of a config for the place `path`; `asks`: what of it `check` would refuse."""

    path: Path
    text: str
    channels: tuple[str, ...]
    experiments: tuple[str, ...]
    asks: tuple[Issue, ...]

    @property
    def reviews(self) -> int:
        return self.text.count(f"# {REVIEW}")

    def __str__(self) -> str:
        marks = "1 mark" if self.reviews == 1 else f"{self.reviews} marks"
        of = f"experiments {', '.join(self.experiments)}; " if self.experiments else ""
        lines = [
            f"{self.path}: {of}channels {', '.join(self.channels)}; {marks} REVIEW to look at",
            *(f"still to do: {one}" for one in self.asks),
        ]
        return "\n".join([*lines, f"then: bayesdrill check {self.path}"])

    __repr__ = __str__


def guess(
    records: Sequence[Path],
    target: Path,
    *,
    voltage: float | None = None,
    gear: float | None = None,
) -> Guess:
    """A config at `target` for the files; `voltage` [V], `gear`: n of n:1, where they are known.

    Raises `InputError` where nothing can be made of a file, or not of all together.
    """
    every, lead = record_files.experiments(records, gear)
    lags = [roles.lag(one.of.found, one.of.part.dt) for one in every]
    hints = [lag for lag in lags if lag is not None]
    found = Found(
        every=every,
        lead=lead,
        starts={one.label: _start(one, voltage) for one in every},
        lag=max(hints, key=lambda lag: lag.clear, default=None),  # of the one that tells it best
        voltage=voltage,
        name=lambda path: sources.name_in(target.parent, path),
    )
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", target.stem).lstrip("_.-")[:100] or "my_rig"
    text = page(found, name)
    channels = tuple(one.name for one in found.channels)
    labels = tuple(one.label for one in every if one.label)
    return Guess(target, text, channels, labels, _asks(text, target, records[0]))


def save_draft(made_: Guess, records: Sequence[Path], *, force: bool) -> None:
    """See `check_place`."""
    check_draft_place(made_.path, records, force=force)
    output_files.write_text(made_.path, made_.text)


def check_draft_place(path: Path, records: Sequence[Path], *, force: bool) -> None:
    """Never over a record, and over another file with `force` alone; raises `InputError`."""
    output_files.refuse_other_than_file(path)
    taken = {record.absolute() for record in records}
    if path.suffix.lower() not in (".yaml", ".yml") or path.absolute() in taken:
        message = "is no name of a config; give an --output that ends in .yaml"
        raise InputError.one(str(path), message)
    if path.exists() and not force:
        raise InputError.one(str(path), "exists already; give --force or another --output")
    if not path.parent.is_dir():
        raise InputError.one(str(path.parent), "there is no such folder; make it first")
    output_files.refuse_unwritable(path.parent)


def _start(one: Experiment, voltage: float | None) -> Start:
    found = one.of.found
    v = None if voltage is not None else found.v
    known = [i.raw.t[0] for i in (v, found.t_1) if i is not None and len(i.raw.t)]
    measured = (v is not None and v.varies) or found.t_1 is not None
    return roles.start(found, one.of.part, measured=measured, known=max(known, default=None))


def _asks(text: str, target: Path, record: Path) -> tuple[Issue, ...]:
    """What is wrong as it stands: a voltage that nobody has told.

    Raises `InputError` where `check` would refuse it with one, too.
    """
    whole = parse(target, text.replace(entries.UNKNOWN, entries.UNKNOWN.replace("# ", "")))
    try:
        assemble(loading.validated(whole))
    except InputError as error:
        message = "`check` would refuse what can be made of it; mend it, or write a config by hand"
        raise InputError([Issue(str(record), message), *error.problems]) from None
    try:
        loading.validated(parse(target, text))
    except InputError as error:
        return error.problems
    return ()
