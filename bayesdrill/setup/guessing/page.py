"""The config as text: every guess under a mark to be reviewed, with its reason."""

from __future__ import annotations

from collections.abc import Sequence

from bayesdrill.basics import symbols
from bayesdrill.setup.guessing import entries, inputs, roles
from bayesdrill.setup.guessing.comments import comment, review, scalar
from bayesdrill.setup.guessing.entries import Found
from bayesdrill.setup.guessing.several import Experiment
from bayesdrill.setup.guessing.start import Start

SPREAD = 1.0  # of the logarithm of a parameter: nobody has said anything of this rig
DAMPING = 0.01  # N m s/rad, which adds 6 % of the critical damping to the paper's rig
FRICTION = 0.1  # N m, as much as the paper's motor has


def page(found: Found, name: str) -> str:
    lead = found.lead.of
    every = [found.name(one.of.path) for one in found.those.every]
    lines = [
        *comment(
            f"A first config of {', '.join(every)}, by `bayesdrill init`. What was guessed stands below "
            "a line with REVIEW and its reason: look at each, mend it or not, and take the line away."
        ),
        "",
        f"name: {scalar(name)}",
        "seed: 1                 # any whole number; the same seed gives the same result",
        "",
        *entries.record(found),
        "",
        *inputs.inputs(found),
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
            turns_back=any(roles.both_ways(one.of.found) for one in found.those.every),
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
    for one in found.those.every:
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
    known = inputs.constant(found)
    return f"v: {known[one.label]}" if len({*known.values()}) > 1 else ""


def _shared(found: Found) -> list[str]:
    """Unknowns of the sensors; moments of steps that are given by hand are not."""
    v = found.lead.of.found.v
    names = ["t_0"] if found.measured else []
    if found.voltage is None and v is not None and not inputs.constant(found):
        names.append("offset_v")
    if found.lag is not None:
        names.append(f"lag_{found.lag.of}")
    return [*names, *(f"sigma_{one.name}" for one in found.channels if not one.derived)]


def _parameters(*, turns_back: bool) -> list[str]:
    """`turns_back`: driven in both directions."""
    table = symbols.NOMINAL[symbols.DEFAULT_NOMINAL].values
    rows: Sequence[tuple[str, str]] = [
        (f"  {name}: {value:.4g}", f"{symbols.PARAMETERS[name].plain_unit}, {_meaning(name)}")
        for name, value in table.items()
    ]
    lines = [
        *review(
            ["this is the paper's rig; write what your data sheets say, and how far it may be off"],
            0,
        ),
        "nominal:",
        f"  table: {symbols.DEFAULT_NOMINAL}",
        "  tolerance: 0.2",
        *(f"{entry:<16}# {said}" for entry, said in rows),
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
        lines.append(f"{entry:<48}# {symbols.PARAMETERS[name].plain_unit}, {_meaning(name)}")
    return lines


def _meaning(name: str) -> str:
    return symbols.PARAMETERS[name].meaning
