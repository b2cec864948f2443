"""Write what follows from the unknowns: derived quantities and friction."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.analysis.friction_motion import FrictionMotion, friction_curve
from bayesdrill.analysis.identifiability.frictions import (
    Confounded,
    Excitation,
    FrictionConfounding,
    ProposedExperiment,
    UnseenStiction,
    drive_words,
    drives_of,
)
from bayesdrill.analysis.latent_torque import TAILS
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol, own_symbol, plain
from bayesdrill.basics.units import Unit
from bayesdrill.inference.derived import Derived, DerivedRow, values_at
from bayesdrill.inference.display_units import DisplayedUnknowns
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Problem
from bayesdrill.report.section import HDI, Table, records_as_csv
from bayesdrill.rig.models.friction import Friction
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.roles import InertiaRoles, Roles

TIME = Symbol("t", "s", "t", "s", "time")


def time_symbol(clock: Unit) -> Symbol:
    """Return the symbol of times in the unit of a clock."""
    return dataclasses.replace(TIME, latex_unit=clock.latex)


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
        cells = {
            "": row.name,
            "unit": plain(row.unit),
            "nominal": "" if row.nominal is None else f"{row.nominal:.4g}",
            "mean": f"{row.mean:.{digits}g}",
            "sd": f"{row.sd:.2g}",
            HDI: f"{row.hdi_low:.{digits}g} to {row.hdi_high:.{digits}g}",
            "dev. %": "" if row.deviation is None else f"{100 * row.deviation:+.2f}",
            "meaning": meanings[row.name] + part,
        }
        lines.append(tuple(cells.values()))
    return Table(tuple(cells), tuple(lines), frozenset(("", "unit", "meaning"))).filled()


def derived_shown(
    problem: Problem, names: Sequence[str] | None, draws: Array, derived: Derived, theta: Array
) -> tuple[Array, DisplayedUnknowns]:
    """Of the unknowns `draws (E, N, D)` and what is derived, those of `names`; None: all unknowns.

    `theta (1, D)` is the MAP.  Draws without a value, and columns of one value alone, are left out
    of those that are returned, `(N, D)` in the units that are shown.
    """
    symbols, units = (*problem.symbols, *derived.symbols), problem.units
    order = [symbol.name for symbol in symbols]
    every = np.concatenate([draws, derived.values], axis=-1).reshape(-1, len(order))
    mode = {name: float(x) for name, x in zip(problem.names, theta[0], strict=True)}
    at_map = values_at(problem, theta).items()
    mode |= {name: float(x[0]) for name, x in at_map if np.isfinite(x[0])}
    wanted = problem.names if names is None else dict.fromkeys(names)
    columns = [order.index(name) for name in wanted if name in order]
    columns = [k for k in columns if len(np.unique(every[np.isfinite(every[:, k]), k])) > 1]
    if not columns:
        return derived_shown(problem, None, draws, derived, theta)
    nominal = {name: x for name, x in derived.nominal.items() if np.isfinite(x)}
    shown = DisplayedUnknowns(
        columns=tuple(columns),
        factors=units.factors(symbols[k] for k in columns),
        symbols=units.symbols(symbols[k] for k in columns),
        priors=units.priors(problem.posterior.space.priors),
        nominal=units.values({**nominal, **problem.nominal}),
        mode=units.values(mode),
    )
    picked = every[:, columns] / shown.factors
    return picked[np.isfinite(picked).all(axis=1)], shown


def effort_symbol(friction: Friction) -> Symbol:
    """Its own, or one that is made of its name."""
    return friction.symbol or own_symbol(
        friction.name, "N*m", None, friction.where or friction.name
    )


def speed_symbol(state: str, inertia: InertiaRoles | None, model: Model) -> Symbol:
    """Of a current or a speed; before a gear it is that of the inertia itself."""
    symbol = model.symbols[state]
    if inertia is None or not inertia.latex:
        return symbol
    meaning = f"speed of {inertia.words}"
    return dataclasses.replace(symbol, latex=rf"\dot{inertia.latex}", meaning=meaning)


@dataclass(frozen=True, slots=True, kw_only=True)
class LawShown:
    """A friction over its speeds `(G,)`: at the MAP, with its band over draws `(2, G)`.

    Also by nominal values, where all that is unknown of it has one; `seen (T,)`: speeds of the record.
    """

    speed: Symbol
    effort: Symbol
    speeds: Array
    best: Array
    band: Array
    nominal: Array | None
    seen: Array


def laws(
    observation: Observation,
    rubbings: Sequence[FrictionMotion],
    problem: Problem,
    best: Array,
    draws: Array,
) -> Iterator[LawShown]:
    """Of one experiment, at the MAP `best (D,)` and draws `(N, D)`."""
    rig, space, known = observation.response.model, problem.posterior.space, problem.nominal
    full = space.full(np.vstack([best[None], draws]))
    values = {name: known.get(name, x) for name, x in zip(space.free, best, strict=True)}
    nominal = space.full(space.vector(values)[None])
    named = observation.named(observation.response.parameters)
    for rubbing in rubbings:
        against = rubbing.friction.against
        inertia = rig.roles.at_friction(against, rubbing.friction.where)
        shown = friction_curve(observation, rubbing, full)
        unknown = {named.get(name, name) for name in rubbing.friction.law.parameters} & {
            *space.free
        }
        compared = unknown and unknown <= {*known}
        yield LawShown(
            speed=speed_symbol(against, inertia, rig),
            effort=effort_symbol(rubbing.friction),
            speeds=shown.speeds,
            best=shown.sizes[0],
            band=np.quantile(shown.sizes[1:], TAILS, axis=0),
            nominal=friction_curve(observation, rubbing, nominal).sizes[0] if compared else None,
            seen=rubbing.speed * rubbing.gear,
        )


EXPERIMENTS: Mapping[str, str] = {
    "turned": "another experiment with the {drive} turned round",
    "turned half-way": "the {drive} turned round half-way",
    "stops": "another experiment at so low a {drive} that it stops ({volts:.2g} {unit})",
    "stops half-way": "so low a {drive} half-way that it stops ({volts:.2g} {unit})",
    "half": "another experiment at half the {drive} ({volts:.3g} {unit})",
}


def friction_sentences(study: FrictionConfounding, model: Model) -> str:
    """A line for each; empty where there is nothing."""
    alike = (_alike(pair, model) for pair in study.alike)
    return "\n".join([*alike, *(_unseen(law, model) for law in study.unseen)])


def _alike(tied: Confounded, model: Model) -> str:
    roles = model.roles
    known = "it were" if len(tied.rivals) == 1 else "these were"
    free = [inertia for inertia in roles.inertias if roles.motor(inertia.name) is None]
    reasons = {}  # where it is not by what the rig did
    for shaft, inertia in itertools.product(roles.shafts, free):
        reasons[frozenset((shaft.damping, inertia.damping))] = (
            f"both take from each swing, and only {inertia.damping} from steady turning"
        )
    for inertia in roles.inertias:
        if inertia.efficiency:
            reasons[frozenset((inertia.efficiency, inertia.sliding))] = (
                "what a gear loses grows with the torque that it passes on, and "
                f"{inertia.sliding} does not"
            )
    why = [reasons[pair] for r in tied.rivals if (pair := frozenset((tied.name, r))) in reasons]
    if tied.deeds is not None and (did := _did(tied.deeds, roles)):
        why.append(f"in these records {did}")
    because = f" ({'; '.join(why)})" if why else ""
    return (
        f"friction: {tied.name} can hardly be told from {listed(tied.rivals)}{because}. If {known} "
        f"known, its sd would be {_about(tied.fall)} times smaller."
        f"{_proposed(tied.name, tied.proposals, model)}"
    )


def _unseen(law: UnseenStiction, model: Model) -> str:
    unit = f"{model.roles.motion.angle}/s"
    turns = model.roles.motion.moves
    return (
        f"friction: static friction {law.deeds.where} does not show. Once it {turns}, it never sticks "
        f"and is never slower than {law.deeds.slowest:.3g} {unit}, while static friction is lost over "
        f"{law.scale:.3g} {unit}. {listed(law.names)} {'is' if len(law.names) == 1 else 'are'} left to "
        f"the prior.{_proposed(law.names[0], law.proposals, model)}"
    )


def _did(deeds: Excitation, roles: Roles) -> str:
    inertia, what, unit = roles.at_friction(deeds.against, deeds.where), "the current flows", "A"
    if inertia is not None:
        what, unit = f"{inertia.words} {roles.motion.moves}", f"{roles.motion.angle}/s"
    speeds = f"{deeds.slowest:.3g} to {deeds.fastest:.3g} {unit}"
    if deeds.reversals == 0:
        return f"{what} one way only, at {speeds}"
    return f"{what} at about one speed, {speeds}" if deeds.one_speed else ""


def _proposed(name: str, proposals: Sequence[ProposedExperiment], model: Model) -> str:
    each = []
    for proposal in proposals:
        drive = drives_of(model)[0]
        named = {"drive": drive_words(model, drive)[0], "unit": model.symbols[drive].plain_unit}
        said = EXPERIMENTS[proposal.what].format(volts=proposal.volts, **named)
        each.append(f"{said} (sd {_about(proposal.shrink)} times smaller)")
    return f" What would show {name}: {', or '.join(each)}." if each else ""


def _about(times: float) -> str:
    """Two digits, and no powers of ten."""
    return f"{float(f'{times:.2g}'):g}"


def listed(names: Sequence[str]) -> str:
    """Join names with commas, and the last with *and*."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
