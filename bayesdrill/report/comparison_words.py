"""Several models of one record, for readers: a verdict, a table, how unknowns move, what predicts."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence

from bayesdrill.inference.residual_checks import Left
from bayesdrill.insight.comparison import (
    SURE,
    Contender,
    Decision,
    decide,
    difference,
    probabilities,
)
from bayesdrill.insight.overlay import Row, differing
from bayesdrill.insight.prediction_scores import FEW, LeftOut
from bayesdrill.report import evidence_words, overlay_words
from bayesdrill.report.overlay_shown import shown
from bayesdrill.report.sections import Note, Picture, Section, Sentences, Table
from bayesdrill.setup.own_units import OwnUnits

TIMES = math.log(1e4)  # odds up to which they are said as a number

READ = (
    "Log evidence: the log of how probable the record is under the model with all that its priors "
    "allow. `against best` is the log of the odds against the most probable, where all were as likely "
    "before; `held out` and `LOO` the difference of predictive scores to the best of the column, with "
    "its standard error; `rms` and `correlation` those of what the MAP leaves, over the noise, in the "
    "channel where they are worst: 1 and 0 where only noise is left."
)


def sections(
    models: Sequence[Contender],
    rows: Sequence[Row],
    own: OwnUnits,
    pictures: Sequence[Picture] = (),
) -> tuple[Section, ...]:
    """In the order in which they are read; `rows` in SI."""
    layers = [one.layer for one in models]
    drawn = (Section("Figures", tuple(pictures), brief=False),) if pictures else ()
    moved = overlay_words.table(layers, [shown(row, own) for row in rows])
    far = Sentences("\n".join(overlay_words.farthest(layers, rows)))
    differ = overlay_words.settings(layers, differing(layers))
    return (
        Section("Verdict", (Sentences("\n".join(verdict(models))),)),
        Section("Models", (table(models), Note(READ), Sentences("\n".join(predicted(models))))),
        *drawn,
        Section("How the unknowns move", (moved, Note(overlay_words.READ), far)),
        Section("What differs between the models", (differ,), brief=False),
    )


def verdict(models: Sequence[Contender]) -> Iterator[str]:
    """Model, noise, or neither; and what makes it doubtful."""
    found = decide(models)
    yield f"verdict: {_decided(models, found)}"
    best = models[found.best]
    if best.like_noise:
        yield f"  what {best.name} leaves looks like the noise"
    else:
        yield f"  what {best.name} leaves is more than noise: none of these models is the whole story"
    for one in models:
        if one.layer.reasons:
            yield f"  DO NOT BELIEVE {overlay_words.doubt(one.layer)}".replace("\n", "\n  ")
    if found.vague:
        yield (
            f"  VAGUE PRIORS: {', '.join(found.vague)}: so wide that a model may have lost by that "
            "alone; give it the range that you believe"
        )
    for one in models:
        if not one.converged:
            yield f"  {one.name} did not converge: its evidence is rough"


def _decided(models: Sequence[Contender], found: Decision) -> str:
    first, best = models[found.first].name, models[found.best].name
    gain = {name: odds(value) for name, value in found.gain.items() if math.isfinite(value)}
    if found.word == "neither":
        return (
            f"NEITHER model nor noise: none is more than {odds(SURE)} times as probable as {first}"
        )
    lead = f"{best} is {gain['first']} times as probable as {first}"
    if found.word == "priors":
        return f"PRIORS: {lead}, with the same rig and the same noise"
    rig = f"{gain.get('model', '')} times as probable as any with the rig of {first}, whatever its noise"
    noise = f"{gain.get('noise', '')} times as probable as any with its noise, whatever the rig"
    if found.word == "model":
        return f"MODEL: {best} is {rig}"
    if found.word == "noise":
        return f"NOISE: {lead}, with the same rig, and {noise}"
    if found.word == "both":
        return f"MODEL AND NOISE: {best} is {rig}, and {noise}"
    return f"MODEL OR NOISE, not told apart: {lead}, and another noise or another rig does about as well"


def odds(log: float) -> str:
    """`1200`, or `e^35` where nobody counts."""
    if log > TIMES:
        return f"e^{log:.0f}"
    value = math.exp(log)
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def table(models: Sequence[Contender]) -> Table:
    """The most probable first."""
    heads = ("model", "unknowns", "log evidence", "against best", "probability")
    more = ("held out", "LOO", "rms", "correlation")
    top = max(one.log_z for one in models)
    order = sorted(range(len(models)), key=lambda k: -models[k].log_z)
    share, held, loo = probabilities(models), _held(models), _loo(models)
    lines = []
    for k in order:
        one = models[k]
        rms, correlation = worst(one.left)
        cells = (
            one.name + ("" if one.converged else " (NOT CONVERGED)"),
            str(len(one.layer.problem.symbols)),
            evidence_words.said(one.evidence),
            f"{one.log_z - top:.1f}" if one.log_z < top else "best",
            f"{share[k]:.3g}" if share[k] > 1e-4 else "0",
        )
        lines.append((*cells, held[k], loo[k], f"{rms:.3g}", f"{correlation:.2g}"))
    return Table((*heads, *more), tuple(lines), frozenset(heads[:1]))


def worst(left: Sequence[Left]) -> tuple[float, float]:
    """Size over the noise and correlation, each in the channel where it is farthest from 1 or 0."""
    rms = max((one.rms for one in left), key=lambda x: abs(math.log(max(x, 1e-300))))
    return rms, max((one.correlation for one in left), key=abs)


def _held(models: Sequence[Contender]) -> list[str]:
    scores = [one.held_out for one in models]
    best = max((one for one in scores if one), key=lambda one: one.score, default=None)
    if best is None:
        return ["-"] * len(models)
    return ["-" if one is None else _apart(*difference(one, best)) for one in scores]


def _loo(models: Sequence[Contender]) -> list[str]:
    told = [one.loo if isinstance(one.loo, LeftOut) else None for one in models]
    best = max((one for one in told if one), key=lambda one: one.elpd, default=None)
    if best is None:
        return ["refused"] * len(models)
    return ["refused" if one is None else _apart(*difference(one, best)) for one in told]


def _apart(value: float, error: float) -> str:
    return "best" if value == 0.0 else f"{value:.1f} +- {error:.1f}"


def predicted(models: Sequence[Contender]) -> Iterator[str]:
    """Where scores come from, and why there are none."""
    held = [one.held_out for one in models if one.held_out is not None]
    if held:
        names = [one.name for one in models if one.held_out is not None]
        best = names[max(range(len(held)), key=lambda k: held[k].score)]
        yield f"held out: {held[0].samples} samples, which {best} predicts best"
    else:
        yield (
            "held out: nothing; `record: {held_out: [from, to]}` [s] in all configs keeps a stretch of "
            "the record from the fit, to be predicted, and `held_out: true` one of several experiments"
        )
    refused: dict[str, list[str]] = {}
    for one in models:
        if isinstance(one.loo, str):
            refused.setdefault(one.loo, []).append(one.name)
        elif one.loo.doubtful > FEW:
            yield f"LOO of {one.name}: {one.loo.doubtful:.0%} of the samples lean on a few draws"
    for reason, names in refused.items():
        yield f"LOO refused for {', '.join(names)}: {reason}"


def as_csv(models: Sequence[Contender], rows: Sequence[Row]) -> str:
    """A line for each model in the order given: SI, all digits."""
    channels = list(dict.fromkeys(one.name for model in models for one in model.left))
    heads = ["model", "unknowns", "converged", "log_evidence", "log_evidence_error", "log_odds"]
    heads += ["probability", "held_out", "held_out_samples", "loo", "loo_refused"]
    heads += [f"{what}_{name}" for name in channels for what in ("rms", "correlation")]
    heads += [f"{row.symbol.name}_{what}" for row in rows for what in ("mean", "sd")]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(heads)
    top, share = max(one.log_z for one in models), probabilities(models)
    for k, one in enumerate(models):
        own = {each.name: each for each in one.left}
        said = [one.name, len(one.layer.problem.symbols), "yes" if one.converged else "no"]
        said += [one.log_z, one.evidence.error, one.log_z - top, share[k]]
        held = one.held_out
        said += ["", ""] if held is None else [held.score, held.samples]
        said += ["", one.loo] if isinstance(one.loo, str) else [one.loo.elpd, ""]
        for name in channels:
            said += [own[name].rms, own[name].correlation] if name in own else ["", ""]
        for row in rows:
            place = row.places[k]
            said += ["", ""] if place is None else [place.mean, place.sd]
        writer.writerow(said)
    return out.getvalue()
