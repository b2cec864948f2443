"""Report friction: its laws over speed, and parameters that resemble friction."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

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
from bayesdrill.analysis.run_analysis import BAND_DRAWS
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol, own_symbol
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Problem
from bayesdrill.report import scales, style
from bayesdrill.report.pages import build_page, legend_above
from bayesdrill.report.section import CREDIBLE, build, listed
from bayesdrill.report.style import Axes, Figure
from bayesdrill.report.view import Drawing, ReportContext, ReportPart, for_each_experiment
from bayesdrill.rig.models.friction import Friction
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.roles import InertiaRoles, Roles


def effort_symbol(friction: Friction) -> Symbol:
    """Return the symbol of a friction's effort: its own, or one made of its name."""
    return friction.symbol or own_symbol(
        friction.name, "N*m", None, friction.where or friction.name
    )


def speed_symbol(state: str, inertia: InertiaRoles | None, model: Model) -> Symbol:
    """Return the symbol of a current or speed; across a gear, it is the inertia's own speed."""
    symbol = model.symbols[state]
    if inertia is None or not inertia.latex:
        return symbol
    meaning = f"speed of {inertia.words}"
    return dataclasses.replace(symbol, latex=rf"\dot{inertia.latex}", meaning=meaning)


@dataclass(frozen=True, slots=True, kw_only=True)
class LawShown:
    """A friction law is shown at `speeds (G,)`: `at_map (G,)` at the MAP, with a `band (2, G)` of draws.

    `nominal (G,)` is the law at nominal values, if all unknowns have one.  `recorded_speeds` are `(T,)`.
    """

    speed: Symbol
    effort: Symbol
    speeds: Array
    at_map: Array
    band: Array
    nominal: Array | None
    recorded_speeds: Array


def laws(
    observation: Observation,
    rubbings: Sequence[FrictionMotion],
    problem: Problem,
    best: Array,
    draws: Array,
) -> Iterator[LawShown]:
    """Yield the friction laws of one experiment, at the MAP `best (D,)` and draws `(N, D)`."""
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
            at_map=shown.sizes[0],
            band=np.quantile(shown.sizes[1:], TAILS, axis=0),
            nominal=friction_curve(observation, rubbing, nominal).sizes[0] if compared else None,
            recorded_speeds=rubbing.speed * rubbing.gear,
        )


EXPERIMENTS: Mapping[str, str] = {
    "turned": "another experiment with the {drive} turned round",
    "turned half-way": "the {drive} turned round half-way",
    "stops": "another experiment at so low a {drive} that it stops ({volts:.2g} {unit})",
    "stops half-way": "so low a {drive} half-way that it stops ({volts:.2g} {unit})",
    "half": "another experiment at half the {drive} ({volts:.3g} {unit})",
}


def friction_sentences(study: FrictionConfounding, model: Model) -> str:
    """Describe each friction that is confounded or unseen in a line; empty if there is none."""
    confounded = (_describe_confounded(pair, model) for pair in study.alike)
    return "\n".join([*confounded, *(_unseen(law, model) for law in study.unseen)])


def _describe_confounded(tied: Confounded, model: Model) -> str:
    roles = model.roles
    known = "it were" if len(tied.rivals) == 1 else "these were"
    free = [inertia for inertia in roles.inertias if roles.motor(inertia.name) is None]
    reasons = {}  # reasons that do not depend on the motion
    for shaft, inertia in itertools.product(roles.shafts, free):
        reasons[frozenset((shaft.damping, inertia.damping))] = (
            f"both damp an oscillation, and only {inertia.damping} brakes steady turning"
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
        f"friction: {tied.name} can hardly be distinguished from {listed(tied.rivals)}{because}. If "
        f"{known} known, its sd would be {_about(tied.fall)} times smaller."
        f"{_proposed(tied.name, tied.proposals, model)}"
    )


def _unseen(law: UnseenStiction, model: Model) -> str:
    unit = f"{model.roles.motion.angle}/s"
    turns = model.roles.motion.verb
    return (
        f"friction: static friction {law.deeds.where} does not show. Once it {turns}, it never sticks "
        f"and is never slower than {law.deeds.slowest:.3g} {unit}, while static friction fades over "
        f"{law.scale:.3g} {unit}. {listed(law.names)} {'is' if len(law.names) == 1 else 'are'} left to "
        f"the prior.{_proposed(law.names[0], law.proposals, model)}"
    )


def _did(deeds: Excitation, roles: Roles) -> str:
    inertia, what, unit = roles.at_friction(deeds.against, deeds.where), "the current flows", "A"
    if inertia is not None:
        what, unit = f"{inertia.words} {roles.motion.verb}", f"{roles.motion.angle}/s"
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
    """Return a number as text, with two digits and without a power of ten."""
    return f"{float(f'{times:.2g}'):g}"


BINS = 60
FOOT = 0.2  # fraction of a panel's height for the histogram of speeds
HEAD = 1.12  # upper end of an axis, relative to the largest effort
BEST: dict[str, Any] = {"color": style.BLACK, "linewidth": 1.0}
SEEN: dict[str, Any] = {"facecolor": style.MIDDLE, "linewidth": 0}


def friction_figure(laws: Sequence[LawShown], width: float = scales.DOUBLE) -> Figure:
    """Draw a panel for each friction law."""
    with style.styled(width):
        figure, panels = build_page(len(laws), 3, 2.1, width, narrow=1)
        for panel, law in zip(panels, laws, strict=True):
            _law(panel, law)
        looks = {"MAP": BEST, f"{CREDIBLE} posterior": style.BAND}
        if any(law.nominal is not None for law in laws):
            looks["nominal values"] = style.NOMINAL
        return legend_above(figure, looks | {"speeds of the record": SEEN})


def _law(panel: Axes, law: LawShown) -> None:
    curves = [law.at_map, *law.band, *([] if law.nominal is None else [law.nominal])]
    limit = HEAD * max(float(np.abs(curve).max()) for curve in curves) or 1.0
    x = scales.scale(float(law.speeds[0]), float(law.speeds[-1]))
    y = scales.scale(-limit, limit)
    room = FOOT / (1.0 - FOOT) * (y.high - y.low)
    for side, outside, beside in ((law.speeds <= 0, -1, -2), (law.speeds >= 0, 0, 1)):
        band = law.band[:, side]
        band[:, outside] = band[:, beside]  # a law jumps between both signs at zero
        panel.fill_between(x(law.speeds[side]), *y(band), zorder=1, **style.BAND)
    if law.nominal is not None:
        panel.plot(x(law.speeds), y(law.nominal), zorder=2, **style.NOMINAL)
    panel.plot(x(law.speeds), y(law.at_map), zorder=3, **BEST)
    counts, edges = np.histogram(x(law.recorded_speeds), np.linspace(x.low, x.high, BINS + 1))
    heights = y.low - room + 0.85 * room * counts / max(int(counts.max()), 1)
    panel.stairs(heights, edges, baseline=y.low - room, fill=True, zorder=1, **SEEN)
    style.scale_axis(panel.xaxis, x, f"{law.speed.meaning}, {x.label(law.speed)}")
    style.scale_axis(panel.yaxis, y, y.label(law.effort, "\n"))
    panel.set_ylim(y.low - room, y.high)
    panel.axhline(y.low, color=style.MIDDLE, linewidth=0.5)


def _draw_friction(run: ReportContext) -> tuple[Drawing, ...]:
    chain, problem = run.chain, run.problem
    each = zip(problem.observations, chain.friction_motions, strict=False)
    at = (problem, chain.best, chain.thinned(BAND_DRAWS))
    shown = ((rig.label, tuple(laws(rig, rubs, *at))) for rig, rubs in each)
    says = "Each friction against its speed: its law, where the record saw it, and nominal values."
    return for_each_experiment(friction_figure, shown, run.width, says)


PART = ReportPart(
    sections=lambda _, pictures: [build("Friction", *pictures, brief=False)],
    figures={"friction": _draw_friction},
)
