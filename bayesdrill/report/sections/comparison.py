"""Compare models of one record: the verdict, a table, predictions, and a figure."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bayesdrill.analysis.comparison import (
    SURE_LOG_ODDS,
    ModelDecision,
    OverlayRow,
    PosteriorSummary,
    RunSummary,
    decide,
    difference,
    differing,
    probabilities,
)
from bayesdrill.analysis.plausibility import DiffusePrior
from bayesdrill.analysis.prediction import MAX_BAD_SHARE, HeldOutScore, LooScore
from bayesdrill.basics.errors import count_noun
from bayesdrill.basics.findings import Finding
from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.inference.residual_checks import ResidualSummary
from bayesdrill.report import scales, style
from bayesdrill.report.findings import finding_sentence
from bayesdrill.report.pages import build_page, is_first_column, legend_above
from bayesdrill.report.section import (
    Note,
    Picture,
    Section,
    Sentences,
    Table,
    build,
    lines_as_csv,
    table_of,
)
from bayesdrill.report.sections import overlay
from bayesdrill.report.style import Axes, Figure
from bayesdrill.report.view import ReportContext, ReportPart
from bayesdrill.sampling.evidence import Evidence


def comparison_sections(
    layers: Sequence[PosteriorSummary],
    models: Sequence[RunSummary],
    rows: Sequence[OverlayRow],
    units: DisplayUnits,
    pictures: Sequence[Picture] = (),
) -> tuple[Section, ...]:
    """Build sections on `models` or, without models, on posteriors `layers`; `rows` are in SI."""
    drawn = [build("Figures", *pictures, brief=False)] if pictures else []
    differs = differing(layers)
    moved = overlay.overlay_table(layers, [overlay.overlay_shown(row, units) for row in rows])
    read, far = Note(overlay.OVERLAY_READ), list(overlay.farthest(layers, rows))
    heads, lines = ("", *(layer.name for layer in layers)), []
    for name, values in differs.items():
        lines.append((name, *(overlay.elided(value or "", overlay.LONGEST) for value in values)))
    settings = Table(heads, tuple(lines), frozenset(heads)) if differs else Note("nothing")
    if not models:
        doubts = [overlay.doubt(layer) for layer in layers if layer.warning]
        names = ", ".join(layer.name for layer in layers)
        return (
            build("", "\n".join([f"{len(layers)} runs: {names}", *doubts])),
            *drawn,
            build("", moved, read, "\n".join([*far, overlay.what_differs(layers, differs)])),
            build("What differs between the runs", settings, brief=False),
        )
    scores = "\n".join(predicted(models))
    return (
        build("Verdict", "\n".join(comparison_verdict(models))),
        *drawn,
        build("Models", comparison_table(models), Note(COMPARISON_READ), scores),
        # `Sentences` are kept even if they are empty, for an empty line on the terminal.
        build("How the unknowns move", moved, read, Sentences("\n".join(far))),
        build("What differs between the models", settings, brief=False),
    )


TIMES = math.log(1e4)  # log of the largest odds that are written as a number
COMPARISON_READ = (
    "`log evidence` is the logarithm of the record's probability under the model, averaged over its "
    "priors. `against best` is the log of a model's probability divided by that of the best model, if "
    "all were equally likely before. `held out` and `LOO` are predictive scores minus the best score of "
    "the column, with standard errors. `rms` and `correlation` (of successive samples) are those of "
    "residuals / noise, in the worst channel: 1 and 0 if only noise is left."
)


def comparison_verdict(models: Sequence[RunSummary]) -> Iterator[str]:
    """Yield whether another model, another noise or neither is needed, and doubts about this."""
    decision = decide(models)
    yield f"verdict: {_decided(models, decision)}"
    best = models[decision.best]
    if best.like_noise:
        yield f"  the residuals of {best.name} look like the noise"
    else:
        yield f"  {best.name} leaves more than noise: none of these models explains the whole record"
    for model in models:
        if model.layer.reasons:
            yield f"  DO NOT BELIEVE {overlay.doubt(model.layer)}".replace("\n", "\n  ")
    if decision.vague:
        yield (
            f"  VAGUE PRIORS: {', '.join(decision.vague)}. They are so wide that a model may have lost "
            "for this reason alone. Give them a plausible range."
        )
    for model in models:
        if not model.converged:
            yield f"  {model.name} did not converge: its evidence is rough"


def _decided(models: Sequence[RunSummary], decision: ModelDecision) -> str:
    first, best = models[decision.first].name, models[decision.best].name
    gain = {name: odds(value) for name, value in decision.gain.items() if math.isfinite(value)}
    lead = f"{best} is {gain.get('first', '')} times as probable as {first}"
    rig = f"{gain.get('model', '')} times as probable as any with {first}'s rig and any noise"
    noise = f"{gain.get('noise', '')} times as probable as any with {first}'s noise and any rig"
    sure = odds(SURE_LOG_ODDS)
    return {
        "neither": "NEITHER another model nor another noise is needed: none of the others is clearly "
        f"more than {sure} times as probable as {first}",
        "priors": f"PRIORS: {lead}, with the same rig and the same noise",
        "model": f"MODEL: {best} is {rig}",
        "noise": f"NOISE: {lead}, with the same rig, and {noise}",
        "both": f"MODEL AND NOISE: {best} is {rig}, and {noise}",
        "either": f"MODEL OR NOISE, not distinguished: {lead}, and another noise or another rig does "
        "about as well",
    }[decision.word]


def odds(log: float) -> str:
    """Return odds as text, for example `1200`, or `e^35` if they are very large."""
    if log > TIMES:
        return f"e^{log:.0f}"
    value = math.exp(log)
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def comparison_table(models: Sequence[RunSummary]) -> Table:
    """Build the table of models, the most probable first."""
    top = max(model.log_z for model in models)
    order = sorted(range(len(models)), key=lambda k: -models[k].log_z)
    probability = probabilities(models)
    held = _against_best([model.held_out for model in models], lambda model: model.score, "-")
    left_out = [model.loo if isinstance(model.loo, LooScore) else None for model in models]
    loo = _against_best(left_out, lambda score: score.elpd, "refused")

    def cells(k: int) -> dict[str, str]:
        model = models[k]
        # Of all channels, the rms that is farthest from 1, and the correlation farthest from 0.
        sizes = (summary.rms for summary in model.residuals)
        rms = max(sizes, key=lambda x: abs(math.log(max(x, 1e-300))))
        correlation = max((summary.correlation for summary in model.residuals), key=abs)
        return {
            "model": model.name + ("" if model.converged else " (NOT CONVERGED)"),
            "unknowns": str(len(model.layer.problem.symbols)),
            "log evidence": evidence_said(model.evidence),
            "against best": f"{model.log_z - top:.1f}" if model.log_z < top else "best",
            "probability": f"{probability[k]:.3g}" if probability[k] > 1e-4 else "0",
            "held out": held[k],
            "LOO": loo[k],
            "rms": f"{rms:.3g}",
            "correlation": f"{correlation:.2g}",
        }

    return table_of(map(cells, order), "model")


def _against_best[S: (HeldOutScore, LooScore)](
    scores: Sequence[S | None], value: Callable[[S], float], none: str
) -> list[str]:
    """Return the difference of each score to the largest; a missing score has the text `none`."""
    best = max((score for score in scores if score), key=value, default=None)
    cells = []
    for score in scores:
        if score is None or best is None:
            cells.append(none)
        else:
            gap, error = difference(score, best)
            cells.append("best" if gap == 0.0 else f"{gap:.1f} +- {error:.1f}")
    return cells


def predicted(models: Sequence[RunSummary]) -> Iterator[str]:
    """Yield sentences on the predictive scores: the held-out samples, and why LOO is not trusted."""
    held = {model.name: model.held_out for model in models if model.held_out is not None}
    if held:
        best = max(held, key=lambda name: held[name].score)
        yield f"held out: {count_noun(held[best].samples, 'sample')}, which {best} predicts best"
    else:
        yield (
            "held out: nothing. `record: {held_out: [from, to]}` [s] in all configs keeps a part of "
            "the record out of the fit, to be predicted. `held_out: true` keeps out an experiment."
        )
    refused: dict[str, list[str]] = {}
    for model in models:
        if isinstance(model.loo, Finding):
            refused.setdefault(finding_sentence(model.loo), []).append(model.name)
        elif model.loo.unreliable > MAX_BAD_SHARE:
            yield f"LOO of {model.name}: {model.loo.unreliable:.0%} of its terms depend on a few draws"
    for reason, names in refused.items():
        yield f"LOO refused for {', '.join(names)}: {reason}"


def comparison_csv(models: Sequence[RunSummary], rows: Sequence[OverlayRow]) -> str:
    """Return CSV with a line for each model in the given order, in SI units and full precision."""
    channels = list(dict.fromkeys(summary.name for model in models for summary in model.residuals))
    heads = ["model", "unknowns", "converged", "log_evidence", "log_evidence_error", "log_odds"]
    heads += ["probability", "held_out", "held_out_samples", "loo", "loo_refused"]
    heads += [f"{what}_{name}" for name in channels for what in ("rms", "correlation")]
    heads += [f"{row.symbol.name}_{what}" for row in rows for what in ("mean", "sd")]
    lines: list[Sequence[object]] = [heads]
    top, none = max(model.log_z for model in models), (None, None)
    for k, (model, probability) in enumerate(zip(models, probabilities(models), strict=True)):
        residuals = {each.name: (each.rms, each.correlation) for each in model.residuals}
        held, places = model.held_out, [row.places[k] for row in rows]
        said = [model.name, len(model.layer.problem.symbols), "yes" if model.converged else "no"]
        said += [model.log_z, model.evidence.error, model.log_z - top, probability]
        said += none if held is None else (held.score, held.samples)
        said += (
            (None, finding_sentence(model.loo))
            if isinstance(model.loo, Finding)
            else (model.loo.elpd, None)
        )
        said += [x for name in channels for x in residuals.get(name, none)]
        said += [x for p in places for x in (none if p is None else (p.mean, p.sd))]
        lines.append(said)
    return lines_as_csv(lines)


FEW_MODELS = 4  # number of models above which an unknown is drawn only if half of them have it
MAX_UNKNOWNS, SCORE_PANELS = 12, 3  # largest number of panels of unknowns; number of other panels
MAX_MODEL_LETTERS = 42  # largest number of letters of a model's name
MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")  # markers of channels
MARK: dict[str, Any] = {"markersize": 4.2, "linestyle": "none"}
LIMIT: dict[str, Any] = {"color": style.MIDDLE, "linewidth": 0.7, "linestyle": (0, (1, 1.5))}
READ = (
    "the most probable model on top; shaded: odds of 20 to 1 or less; "
    f"bars: means and {overlay.NARROWEST}s"
)


def comparison_figure(
    models: Sequence[RunSummary], rows: Sequence[OverlayRow], display_units: DisplayUnits
) -> Figure:
    """Draw models, the most probable one on top and in black; `rows` of unknowns are in SI units."""
    order = sorted(range(len(models)), key=lambda k: -models[k].log_z)
    layers = [model.layer for model in models]
    # An unknown is drawn if two models have it; with more than `FEW_MODELS`, half of them must.
    least = max(2, len(models) / 2) if len(models) > FEW_MODELS else 2
    common = [row for row in rows if sum(p is not None and p.sd > 0 for p in row.places) >= least]
    shared = [overlay.scaled_row(row, layers, display_units) for row in common[:MAX_UNKNOWNS]]
    names = [_name(models[k]) for k in order]
    channels = dict.fromkeys(row.name for model in models for row in model.residuals)
    marks = dict(zip(channels, itertools.cycle(MARKS), strict=False))
    with style.styled():
        height = overlay.AXIS_HEIGHT + len(models) * overlay.RUN_HEIGHT
        figure, panels = build_page(SCORE_PANELS + len(shared), 3, height)
        ordered = [models[k] for k in order]
        _odds(panels[0], ordered)
        rms, correlation = "rms of residuals over noise", "their correlation"
        _residual_panel(panels[1], ordered, marks, lambda row: row.rms, 1.0, rms)
        _residual_panel(panels[2], ordered, marks, lambda row: row.correlation, 0.0, correlation)
        looks = [overlay.RunStyle(_colour(k), "-", "o", size=3.6) for k in range(len(order))]
        for panel, (row, scale) in zip(panels[SCORE_PANELS:], shared, strict=True):
            overlay.draw_intervals(panel, row, scale, order, looks, arrow=False)
        for panel in panels:
            side = is_first_column(panel)
            overlay.stack_runs(panel, len(models), names if side else None)
            panel.tick_params(axis="y", length=0)
        figure.supxlabel(READ, fontsize=8.0, color=style.DARK)
        return legend_above(figure, _model_looks(models))


def _name(model: RunSummary) -> str:
    name = overlay.elided(model.name, MAX_MODEL_LETTERS)
    return (name if model.converged else f"{name} *").replace("$", r"\$")


def _odds(panel: Axes, models: Sequence[RunSummary]) -> None:
    """Draw log odds against the most probable model; the axis is linear up to odds of 20 to 1."""
    off = np.array([models[0].log_z - model.log_z for model in models])
    panel.set_xscale("symlog", linthresh=SURE_LOG_ODDS, linscale=0.8)
    panel.axvspan(0.0, SURE_LOG_ODDS, **style.CHANCE)
    for k, (model, x) in enumerate(zip(models, off, strict=True)):
        y, colour = len(models) - 1 - k, _colour(k)
        panel.plot([0.0, x], [y, y], color=colour, linewidth=1.4, solid_capstyle="butt")
        panel.plot([x], [y], marker="o", markersize=4, color=colour, linestyle="none")
        panel.plot([x - model.evidence.error, x + model.evidence.error], [y, y], color=colour)
    most = max(1.6 * float(off.max()), 2.0 * SURE_LOG_ODDS)
    panel.set_xlim(-0.3, most)
    # A long axis has every second decade, so that numbers do not overlap.
    far = [k for k in range(1, 9) if 10.0**k < most][:: 1 + int(np.log10(most) > 3.5)]
    ticks = [0.0, SURE_LOG_ODDS, *(10.0**k for k in far)]
    texts = ["0", f"{SURE_LOG_ODDS:.0f}"]
    texts += [f"{10**k}" if k < 4 else rf"$10^{{{k}}}$" for k in far]
    style.set_ticks(panel.xaxis, ticks, texts)
    panel.set_xlabel("log odds against the best", labelpad=2)


def _residual_panel(
    panel: Axes,
    models: Sequence[RunSummary],
    marks: Mapping[str, str],
    value_of: Callable[[ResidualSummary], float],
    ideal: float,
    label: str,
) -> None:
    """Draw a mark for each model and channel; `ideal` is the value if only noise is left."""
    log = ideal == 1.0
    least, most = (0.8, 1.25) if log else (-0.1, 0.1)
    values = [value_of(row) for model in models for row in model.residuals]
    scale = scales.scale(min(*values, least), max(*values, most), log=log, margin=0.08)
    panel.axvline(float(scale(ideal)), zorder=1, **LIMIT)
    for k, model in enumerate(models):
        for row in model.residuals:
            look = {**MARK, "marker": marks[row.name], "color": _colour(k)}
            face = _colour(k) if row.like_noise else "white"
            x, y = float(scale(value_of(row))), len(models) - 1 - k
            panel.plot([x], [y], markerfacecolor=face, **look)
    style.scale_axis(panel.xaxis, scale, label)


def _colour(k: int) -> str:
    return style.BLACK if k == 0 else style.MIDDLE


def _model_looks(models: Sequence[RunSummary]) -> dict[str, style.Look]:
    symbols = {}
    for model in models:
        for observation in model.layer.problem.observations:
            where = " in " + observation.label.replace("$", r"\$") if observation.label else ""
            for channel in observation.experiment.channels:
                symbols[channel.name, observation.label] = f"${channel.latex}${where}"
    look = {**MARK, "color": style.DARK}
    marks = zip(symbols.values(), itertools.cycle(MARKS), strict=False)
    return {
        **{symbol: {**look, "marker": mark} for symbol, mark in marks},
        "not like noise": {**look, "marker": "o", "markerfacecolor": "white"},
        "nominal value": style.NOMINAL,
    }


POOR = 0.1  # standard error of a log evidence, above which the evidence is called rough
EVIDENCE_EXPLAINED = (
    "The log evidence is the natural logarithm of the samples' probability under the model, averaged "
    "over its priors. It has no meaning by itself. The difference between two models of one record is "
    "the log of their odds, if both were equally likely before (`bayesdrill compare`)."
)


def evidence_sentences(
    evidence: Evidence, priors: Sequence[DiffusePrior], *, converged: bool
) -> str:
    """Describe the evidence in a line, and doubts about it in further lines."""
    lines = [f"log evidence: {evidence_said(evidence)}"]
    if evidence.steps_error:
        lines.append(
            f"  of which {evidence.steps:+.2g} +- {evidence.steps_error:.1g} for the error of its steps"
        )
    rough = ""
    if not converged:
        rough = "the ensembles did not converge"
    elif evidence.error > POOR and evidence.steps_error > 0.5 * evidence.error:
        rough = "the time steps of the rig are too long; a larger `model.pieces` helps"
    elif evidence.error > POOR:
        rough = "the samplers' proposal hardly overlaps the posterior; longer chains would help"
    if rough:
        lines.append(f"  ROUGH: {rough}")
    wide = [
        f"the prior sd of {prior.name} is {prior.times:.0f} times its estimate"
        if prior.decades is None
        else f"the prior of {prior.name} is {prior.decades:.1f} decades wide"
        for prior in priors
    ]
    if wide:
        lines.append(
            f"  VAGUE PRIORS: {', '.join(wide)}. Each doubling of a range halves the evidence, which "
            "may decide a comparison of models. Give these priors a plausible range."
        )
    return "\n".join(lines)


def evidence_said(evidence: Evidence) -> str:
    """Return the evidence as text, with as many digits as its error allows."""
    digits = max(0, min(4, -math.floor(math.log10(max(evidence.error, 1e-4)))))
    return f"{evidence.log_z:.{digits}f} +- {evidence.error:.1g}"


def _evidence(run: ReportContext, _: Sequence[Picture]) -> Iterator[Section]:
    evidence, converged = run.analysis.evidence, run.sampled.convergence.converged
    if evidence is not None:
        said = evidence_sentences(evidence, run.analysis.vague, converged=converged)
        yield build("Evidence", said, Note(EVIDENCE_EXPLAINED))


EVIDENCE = ReportPart(sections=_evidence)
