"""Write what follows from the unknowns: derived quantities, energy and friction."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bayesdrill.analysis.energy import (
    AT_START,
    CONVERTED,
    STORED,
    EnergyAccount,
    EnergyPart,
    FrictionMotion,
    friction_curve,
)
from bayesdrill.analysis.identifiability.frictions import (
    Confounded,
    Excitation,
    FrictionConfounding,
    ProposedExperiment,
    UnseenStiction,
)
from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.basics.symbols import Symbol, own_symbol, plain
from bayesdrill.basics.units import Unit
from bayesdrill.inference.derived import HDI_PROBABILITY, Derived, DerivedRow, values_at
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Problem
from bayesdrill.report.section import HDI, Table, records_as_csv
from bayesdrill.rig import models
from bayesdrill.rig.models.friction import Friction
from bayesdrill.rig.models.linear import Model, Roles

if TYPE_CHECKING:
    from bayesdrill.analysis.run_analysis import EnergySummary

_HEADERS = ("", "unit", "nominal", "mean", "sd", HDI, "dev. %", "meaning")


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionShown:
    """What a corner plot shows: `draws (N, D)`, and nominal and MAP where there are any; SI."""

    draws: Array
    symbols: tuple[Symbol, ...]
    nominal: dict[str, float]
    mode: dict[str, float]


def derived_csv(rows: Sequence[DerivedRow]) -> str:
    """All digits, SI; `share` of the draws have the quantity, `deviation` is a fraction."""
    return records_as_csv(DerivedRow, rows)


def derived_table(rows: Sequence[DerivedRow], meanings: Mapping[str, str]) -> Table:
    """Of what follows, with its meanings."""
    lines = []
    for row in rows:
        part = "" if row.share == 1.0 else f"; {100 * (1 - row.share):.2g} % of the draws have none"
        ratio = abs(row.mean) / row.sd if row.sd > 0 else 1.0
        digits = max(4, min(12, 2 + math.ceil(math.log10(max(ratio, 1.0)))))  # down to the sd's
        cells = (
            row.name,
            plain(row.unit),
            "" if row.nominal is None else f"{row.nominal:.4g}",
            f"{row.mean:.{digits}g}",
            f"{row.sd:.2g}",
            f"{row.hdi_low:.{digits}g} to {row.hdi_high:.{digits}g}",
            "" if row.deviation is None else f"{100 * row.deviation:+.2f}",
            meanings[row.name] + part,
        )
        lines.append(cells)
    left = frozenset((_HEADERS[0], _HEADERS[1], _HEADERS[-1]))
    return Table(_HEADERS, tuple(lines), left).filled()


def derived_shown(
    problem: Problem,
    names: Sequence[str] | None,
    draws: Array,
    derived: Derived,
    theta: Array,
) -> FrictionShown:
    """Of the unknowns `draws (E, N, D)` and what is derived, those of `names`; None: all unknowns.

    `theta (1, D)` is the MAP.  Draws without a value, and columns of one value alone, are left out.
    """
    every = np.concatenate([draws, derived.values], axis=-1)
    symbols = (*problem.symbols, *derived.symbols)
    unknown = [symbol.name for symbol in problem.symbols]
    order = [symbol.name for symbol in symbols]
    mode = {name: float(x) for name, x in zip(unknown, theta[0], strict=True)}
    mode |= {
        name: float(x[0]) for name, x in values_at(problem, theta).items() if np.isfinite(x[0])
    }
    wanted = unknown if names is None else [name for name in dict.fromkeys(names) if name in order]
    picked = every.reshape(-1, len(order))[:, [order.index(name) for name in wanted]]
    some = [
        k for k in range(len(wanted)) if len(np.unique(picked[np.isfinite(picked[:, k]), k])) > 1
    ]
    if not some:
        return derived_shown(problem, None, draws, derived, theta)
    picked = picked[:, some]
    nominal = {name: x for name, x in derived.nominal.items() if np.isfinite(x)}
    return FrictionShown(
        draws=picked[np.isfinite(picked).all(axis=1)],
        symbols=tuple(symbols[order.index(wanted[k])] for k in some),
        nominal={**nominal, **problem.nominal},
        mode=mode,
    )


NAMES: Mapping[str, str] = {  # of roles
    "motor.voltage": "supply",
    "rotor.load": "load",
    "motor.resistance": "resistance of the motor",
    "motor.series": "resistance in series",
    "motor.damping": "viscous, at the motor",
    "shaft.damping": "viscous, in the shaft",
    "rotor.damping": "viscous, at rotor 1",
}
OPEN = 1e-3  # of all, from which on what does not close is said

READ = (
    "At the MAP: what came in, and what became of it until the end of the record. `share` is that of "
    "all that came in, `sd` of it over the posterior. Each is an integral of a power over all steps, "
    "exact where no speed changes its sign"
)


def energy_names(part: str, model: Model) -> str:
    """What a table or a legend calls it."""
    motor, names = model.roles.motor, {model.roles[role]: said for role, said in NAMES.items()}
    names |= {
        motor.friction: f"friction {motor.friction}",
        CONVERTED: f"{motor.torque_constant} is not {motor.back_emf}",
        AT_START: "stored at the start",
        STORED: "stored",
    }
    for friction in model.frictions:
        drop = friction.against == motor.current
        names[friction.name] = "voltage drop" if drop else f"friction {friction.where}"
    return names.get(part, part)


def energy_table(summary: EnergySummary, model: Model) -> Table:
    """In the order: what came in, the largest first; what it went to; what is stored."""
    surely = any(part.sd is not None for part in summary.parts)
    heads = ("", "", "J", "share", *(("sd",) if surely else ()))
    lines = []
    for side, names in (("in", summary.came), ("out", summary.went)):
        for part in ordered(summary, names):
            sure = (f"{100 * part.sd:.2g} %",) if part.sd is not None else ("",) * surely
            share = f"{100 * part.share:.3g} %"
            lines.append((side, energy_names(part.name, model), f"{part.joules:.4g}", share, *sure))
    return Table(heads, tuple(lines), frozenset(heads[:1]))


def ordered(summary: EnergyAccount | EnergySummary, names: Collection[str]) -> list[EnergyPart]:
    """The largest first; what is stored stands last."""
    parts = [part for part in summary.parts if part.name in names]
    return sorted(parts, key=lambda part: (part.name == STORED, -part.joules))


KINDS = ("electrical", "viscous", "friction", "other", "stored")  # of losses, in this order


@dataclass(frozen=True, slots=True, kw_only=True)
class Stacked:
    """`kind`: one of `KINDS`; `name` for a legend; `joules (N,)`."""

    kind: str
    name: str
    joules: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Balance:
    """At times `t (N,)` in the unit of `time`: `total` that came in from `sources`; what it became."""

    t: Array
    time: Symbol
    total: Array
    sources: str
    parts: tuple[Stacked, ...]


def energy_balance(account: EnergyAccount, model: Model, clock: Unit) -> Balance:
    """For a figure."""
    motor, rubs = (
        model.roles.motor,
        {friction.name: friction.against for friction in model.frictions},
    )
    viscous = (motor.damping, model.roles.shaft.damping, model.roles.rotor.damping)
    kinds = {
        **dict.fromkeys((motor.resistance, motor.series), "electrical"),
        **dict.fromkeys(viscous, "viscous"),
        **{n: "electrical" if s == motor.current else "friction" for n, s in rubs.items()},
        motor.friction: "friction",
        STORED: "stored",
    }
    parts = [
        Stacked(
            kind=kinds.get(p.name, "other"),
            name=energy_names(p.name, model),
            joules=account.went[p.name],
        )
        for p in ordered(account, account.went)
    ]
    return Balance(
        t=account.t / clock.factor,
        time=Symbol("t", clock.name, "t", clock.latex, "time"),
        total=account.total,
        sources=", ".join(energy_names(p.name, model) for p in ordered(account, account.came)),
        parts=tuple(sorted(parts, key=lambda part: KINDS.index(part.kind))),
    )


def energy_note(summary: EnergySummary, model: Model) -> str:
    """Explain the table of energies."""
    left = (
        f", but {100 * summary.left:.2g} % of it is in neither, because of steps in which a speed "
        "changes its sign: finer steps are `model: {pieces: ...}`"
    )
    said = READ + (left if summary.left > OPEN else "") + "."
    given, taken = model.roles.motor.torque_constant, model.roles.motor.back_emf
    unequal = (
        f"*{given} is not {taken}*: what a motor gives beyond what it takes, ({given} - {taken}) times "
        "current and speed. In an ideal one the two are equal."
    )
    return f"{said} {unequal}" if CONVERTED in (*summary.came, *summary.went) else said


TAILS = (0.5 - HDI_PROBABILITY / 2, 0.5 + HDI_PROBABILITY / 2)
MOTOR = Symbol("w_3", "rad/s", r"\dot\theta_3", "rad/s", "speed of the motor")


def effort_symbol(friction: Friction) -> Symbol:
    """Its own, or one that is made of its name."""
    return friction.symbol or own_symbol(
        friction.name, "N*m", None, friction.where or friction.name
    )


def speed_symbol(state: str, roles: Roles) -> Symbol:
    """Of the motor before the gear."""
    return MOTOR if state == roles.motor.speed else models.STATES[state]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionCourse:
    """A friction over time: `effort (T,)` at the MAP.

    `band (2, T)`: where there are draws; the rotor `sticks` between these times.
    """

    label: Symbol
    effort: Array
    band: Array | None
    sticks: tuple[tuple[float, float], ...]

    def at(self, samples: Indices) -> FrictionCourse:
        """Return it at these samples."""
        band = None if self.band is None else self.band[:, samples]
        return dataclasses.replace(self, effort=self.effort[samples], band=band)


@dataclass(frozen=True, slots=True, kw_only=True)
class LawShown:
    """A friction over its speeds `(G,)`: at the MAP, with its band over draws `(2, G)`.

    Also by nominal values, where all of it has one; `seen (T,)`: the speeds of the record.
    """

    speed: Symbol
    effort: Symbol
    where: str
    speeds: Array
    best: Array
    band: Array | None
    nominal: Array | None
    seen: Array


def rubs(rubbings: Sequence[FrictionMotion], clock: Unit) -> tuple[FrictionCourse, ...]:
    """Of one experiment."""
    return tuple(
        FrictionCourse(
            label=effort_symbol(rubbing.friction),
            effort=rubbing.effort,
            band=None if len(rubbing.efforts) < 2 else np.quantile(rubbing.efforts, TAILS, axis=0),
            sticks=tuple((a / clock.factor, b / clock.factor) for a, b in rubbing.intervals),
        )
        for rubbing in rubbings
    )


def laws(
    observation: Observation,
    rubbings: Sequence[FrictionMotion],
    problem: Problem,
    best: Array,
    draws: Array,
) -> tuple[LawShown, ...]:
    """Of one experiment, at the MAP `best (D,)` and draws `(N, D)`."""
    space, every = problem.posterior.space, []
    for rubbing in rubbings:
        points = np.vstack([best[None], draws])
        shown = friction_curve(observation, rubbing, space.full(points))
        every.append(
            LawShown(
                speed=speed_symbol(rubbing.friction.against, observation.response.model.roles),
                effort=effort_symbol(rubbing.friction),
                where=rubbing.friction.where,
                speeds=shown.speeds,
                best=shown.sizes[0],
                band=np.quantile(shown.sizes[1:], TAILS, axis=0) if len(draws) > 1 else None,
                nominal=_nominal(observation, rubbing, problem, best),
                seen=rubbing.speed * rubbing.gear,
            )
        )
    return tuple(every)


def _nominal(
    observation: Observation, rubbing: FrictionMotion, problem: Problem, best: Array
) -> Array | None:
    """By the nominal values of what the law names; None where one of them is unknown and has none."""
    space = problem.posterior.space
    named = observation.named(observation.response.parameters)
    names = {named.get(name, name) for name in rubbing.friction.law.parameters}
    if not names & {*space.free} or not names & {*space.free} <= {*problem.nominal}:
        return None
    values = {name: problem.nominal.get(name, x) for name, x in zip(space.free, best, strict=True)}
    return np.asarray(
        friction_curve(observation, rubbing, space.full(space.vector(values)[None])).sizes[0]
    )


EXPERIMENTS: Mapping[str, str] = {
    "turned": "another experiment with the voltage turned round",
    "turned half-way": "the voltage turned round half-way",
    "stops": "another experiment at so low a voltage that it stops ({volts:.2g} V)",
    "stops half-way": "so low a voltage half-way that it stops ({volts:.2g} V)",
    "half": "another experiment at half the voltage ({volts:.3g} V)",
}


def friction_sentences(study: FrictionConfounding) -> str:
    """A line for each; empty where there is nothing."""
    alike = (_alike(pair, study.roles) for pair in study.alike)
    return "\n".join([*alike, *map(_unseen, study.unseen)])


def _alike(one: Confounded, roles: Roles) -> str:
    motor, shaft, rotor = roles.motor, roles.shaft, roles.rotor
    known = "it were" if len(one.rivals) == 1 else "these were"
    swings = f"both take from each swing, and only {rotor.damping} from steady turning"
    loses = (
        f"what a gear loses grows with the torque that it passes on, and {motor.sliding} does not"
    )
    reasons = {  # where it is not by what the rig did
        frozenset((shaft.damping, rotor.damping)): swings,
        frozenset((motor.efficiency, motor.sliding)): loses,
    }
    why = [reasons[pair] for r in one.rivals if (pair := frozenset((one.name, r))) in reasons]
    if one.deeds is not None and (did := _did(one.deeds, roles)):
        why.append(f"in these records {did}")
    because = f" ({'; '.join(why)})" if why else ""
    return (
        f"friction: {one.name} can hardly be told from {listed(one.rivals)}{because}. If {known} known, "
        f"its sd would be {_about(one.fall)} times smaller.{_proposed(one.name, one.proposals)}"
    )


def _unseen(law: UnseenStiction) -> str:
    speed = f"{law.deeds.slowest:.3g} rad/s"
    return (
        f"friction: static friction {law.deeds.where} does not show. Once it turns, it never sticks and "
        f"is never slower than {speed}, while static friction is lost over {law.scale:.3g} rad/s. "
        f"{listed(law.names)} {'is' if len(law.names) == 1 else 'are'} left to the prior."
        f"{_proposed(law.names[0], law.proposals)}"
    )


def _did(deeds: Excitation, roles: Roles) -> str:
    """What the rig did not do."""
    what, unit = {
        roles.motor.speed: ("the motor turns", "rad/s"),
        roles.rotor.speed: ("rotor 1 turns", "rad/s"),
    }.get(deeds.against, ("the current flows", "A"))
    speeds = f"{deeds.slowest:.3g} to {deeds.fastest:.3g} {unit}"
    if deeds.one_way:
        return f"{what} one way only, at {speeds}"
    return f"{what} at about one speed, {speeds}" if deeds.one_speed else ""


def _proposed(name: str, proposals: Sequence[ProposedExperiment]) -> str:
    each = [
        f"{EXPERIMENTS[p.what].format(volts=p.volts)} (sd {_about(p.shrink)} times smaller)"
        for p in proposals
    ]
    return f" What would show {name}: {', or '.join(each)}." if each else ""


def _about(times: float) -> str:
    """Two digits, and no powers of ten."""
    return f"{float(f'{times:.2g}'):g}"


def listed(names: Sequence[str]) -> str:
    """Join names with commas, and the last with *and*."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
