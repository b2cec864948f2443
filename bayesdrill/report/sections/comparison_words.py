"""Write what a comparison of runs or of models says: verdict, tables, what differs, what predicts."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence

from bayesdrill.analysis.comparison import (
    SURE_LOG_ODDS,
    MarginalEstimate,
    ModelDecision,
    OverlayRow,
    PosteriorSummary,
    RunSummary,
    decide,
    difference,
    differing,
    probabilities,
)
from bayesdrill.analysis.prediction import MAX_BAD_SHARE, HeldOutScore, LooScore
from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.inference.priors import flat_in_logs
from bayesdrill.report.section import (
    HDI_ENDS,
    Note,
    Picture,
    Section,
    Sentences,
    Table,
    build,
    lines_as_csv,
)
from bayesdrill.report.sections import verdict_words


def overlay_shown(row: OverlayRow, units: DisplayUnits) -> OverlayRow:
    """In the unit that its symbol then has."""
    factor = units.factor(row.symbol.name)
    return dataclasses.replace(
        row,
        symbol=units.symbol(row.symbol),
        places=tuple(
            place
            and MarginalEstimate(**{k: x / factor for k, x in dataclasses.asdict(place).items()})
            for place in row.places
        ),
        nominal=tuple(None if value is None else value / factor for value in row.nominal),
    )


def in_logs(row: OverlayRow, layers: Sequence[PosteriorSummary]) -> bool:
    """Whether the prior of the first run that has this unknown is flat in its log."""
    priors = (
        layer.problem.posterior.space.priors.get(row.symbol.name)
        for layer in layers
        if row.symbol in layer.problem.symbols
    )
    return flat_in_logs(next(priors, None))


LONGEST = 60  # letters of a setting
SAID = 3  # unknowns that are farthest apart
FAR = 0.5  # sds, below which nothing is said of it
APART = "apart [sd]"
OVERLAY_READ = (
    "Mean and sd of each run, in the unit of the first. "
    f"`{APART}` is the largest difference of two means over the root mean square of their sds. Two "
    "independent records of one rig are more than 2.8 apart once in twenty times by chance. Runs of one "
    "record differ by their priors, held values and models."
)
COLUMNS = ("name", "unit", "run", "nominal", "mean", "sd", *HDI_ENDS, "held", "apart")


def comparison_sections(
    layers: Sequence[PosteriorSummary],
    models: Sequence[RunSummary],
    rows: Sequence[OverlayRow],
    units: DisplayUnits,
    pictures: Sequence[Picture] = (),
) -> tuple[Section, ...]:
    """In the order in which they are read, of runs or, if there are any, `models`; `rows` in SI."""
    drawn = [build("Figures", *pictures, brief=False)] if pictures else []
    differs = differing(layers)
    moved = overlay_table(layers, [overlay_shown(row, units) for row in rows])
    read, far = Note(OVERLAY_READ), list(farthest(layers, rows))
    heads, lines = ("", *(layer.name for layer in layers)), []
    for name, values in differs.items():
        lines.append((name, *(elided(value or "", LONGEST) for value in values)))
    settings = Table(heads, tuple(lines), frozenset(heads)) if differs else Note("nothing")
    if not models:
        doubts = [doubt(layer) for layer in layers if layer.warning]
        names = ", ".join(layer.name for layer in layers)
        return (
            build("", "\n".join([f"{len(layers)} runs: {names}", *doubts])),
            build("", moved, read, "\n".join([*far, _what_differs(layers, differs)])),
            *drawn,
            build("What differs between the runs", settings, brief=False),
        )
    scores = "\n".join(predicted(models))
    return (
        build("Verdict", "\n".join(comparison_verdict(models))),
        build("Models", comparison_table(models), Note(COMPARISON_READ), scores),
        *drawn,
        # Also where nothing is said of it: a terminal then shows an empty line.
        build("How the unknowns move", moved, read, Sentences("\n".join(far))),
        build("What differs between the models", settings, brief=False),
    )


def overlay_csv(layers: Sequence[PosteriorSummary], rows: Sequence[OverlayRow]) -> str:
    """A line for each unknown and run that has it, SI, all digits; `apart` is of all runs."""
    lines: list[Sequence[object]] = [COLUMNS]
    for row in rows:
        for layer, place, nominal in zip(layers, row.places, row.nominal, strict=True):
            if place is not None:
                sd = (place.sd, place.low, place.high)
                numbers = (nominal, place.mean, *((None,) * 3 if place.fixed else sd))
                last = ("yes" if place.fixed else "no", row.distance)
                lines.append((row.symbol.name, row.symbol.unit, layer.name, *numbers, *last))
    return lines_as_csv(lines)


def doubt(layer: PosteriorSummary) -> str:
    """What its figures carry, and why it must not be believed."""
    because = "".join(f"\n  - {reason}" for reason in layer.reasons)
    return f"{layer.name}: {layer.warning}{because}"


def overlay_table(layers: Sequence[PosteriorSummary], rows: Sequence[OverlayRow]) -> Table:
    """Return the table of unknowns, a column for each run."""
    heads = ("", "unit", "nominal", *(layer.name for layer in layers), APART)
    lines = []
    for row in rows:
        known = [value for value in row.nominal if value is not None]
        nominal = "" if not known else "differs" if row.agreed is None else f"{row.agreed:.4g}"
        apart = "" if row.distance is None else f"{row.distance:.2f}"
        if row.pair is not None and len(layers) > 2:
            apart += f" ({', '.join(layers[k].name for k in row.pair)})"
        cells = []
        for place in row.places:
            sure = f"\N{PLUS-MINUS SIGN} {place.sd:.2g}" if place and not place.fixed else "held"
            cells.append("" if place is None else f"{place.mean:.4g} {sure}")
        lines.append((row.symbol.name, row.symbol.plain_unit, nominal, *cells, apart))
    return Table(heads, tuple(lines), frozenset(heads[:2])).filled("nominal", APART)


def farthest(layers: Sequence[PosteriorSummary], rows: Sequence[OverlayRow]) -> Iterator[str]:
    """Say which unknowns of two runs are farthest apart."""
    pairs = [(row.distance, row) for row in rows if row.distance is not None]
    ordered = sorted(pairs, key=lambda pair: -pair[0])
    if not ordered:
        yield "no unknown is shared by two of the runs"
        return
    far = [(apart, row) for apart, row in ordered if apart >= FAR]
    if not far:
        yield f"nowhere are two of them more than {ordered[0][0]:.2g} sd apart"
    for apart, row in far[:SAID]:
        assert row.pair is not None
        first, other = (layers[k].name for k in row.pair)
        yield f"{row.symbol.name}: {first} and {other} are {apart:.2g} sd apart"


def _what_differs(
    layers: Sequence[PosteriorSummary], differs: dict[str, tuple[str | None, ...]]
) -> str:
    spaces = [layer.problem.posterior.space for layer in layers]
    unknown = {name for s in spaces for name in (*s.free, *s.fixed, *s.relations)}
    believed = [name for name in differs if name in unknown]
    # All channels, and the noise of all of them, in one word.
    kinds = {"the channel ": "the channels", "the noise of ": "the noise"}
    others = dict.fromkeys(
        next((kind for start, kind in kinds.items() if name.startswith(start)), name)
        for name in differs
        if name not in unknown
    )
    listed = [*([f"what is believed of {', '.join(believed)}"] if believed else []), *others]
    if not listed:
        return "record, noise, priors and seed are the same"
    return f"not the same: {'; '.join(listed)}"


def elided(text: str, most: int) -> str:
    """Without letters of its middle, where it has more than so many: names differ at their ends."""
    left = most - 3
    return text if len(text) <= most else f"{text[: left // 2]}...{text[-(left - left // 2) :]}"


TIMES = math.log(1e4)  # odds up to which they are said as a number

COMPARISON_READ = (
    "Log evidence: the log of how probable the record is under the model with all that its priors "
    "allow. `against best` is the log of the odds against the most probable model, if all were equally "
    "likely before. `held out` and `LOO` are differences of predictive scores to the best of the "
    "column, with standard errors. `rms` and `correlation` are those of the residuals over the noise, "
    "in the worst channel: 1 and 0 where only noise is left."
)


def comparison_verdict(models: Sequence[RunSummary]) -> Iterator[str]:
    """Model, noise, or neither; and what makes it doubtful."""
    decision = decide(models)
    yield f"verdict: {_decided(models, decision)}"
    best = models[decision.best]
    if best.like_noise:
        yield f"  the residuals of {best.name} look like the noise"
    else:
        yield f"  {best.name} leaves more than noise: none of these models explains the whole record"
    for model in models:
        if model.layer.reasons:
            yield f"  DO NOT BELIEVE {doubt(model.layer)}".replace("\n", "\n  ")
    if decision.vague:
        yield (
            f"  VAGUE PRIORS: {', '.join(decision.vague)}. They are so wide that a model may have lost "
            "by that alone. Give them the range that you believe."
        )
    for model in models:
        if not model.converged:
            yield f"  {model.name} did not converge: its evidence is rough"


def _decided(models: Sequence[RunSummary], decision: ModelDecision) -> str:
    first, best = models[decision.first].name, models[decision.best].name
    gain = {name: odds(value) for name, value in decision.gain.items() if math.isfinite(value)}
    lead = f"{best} is {gain.get('first', '')} times as probable as {first}"
    rig = f"{gain.get('model', '')} times as probable as any with the rig of {first}, whatever its noise"
    noise = f"{gain.get('noise', '')} times as probable as any with its noise, whatever the rig"
    sure = odds(SURE_LOG_ODDS)
    return {
        "neither": f"NEITHER model nor noise: none is more than {sure} times as probable as {first}",
        "priors": f"PRIORS: {lead}, with the same rig and the same noise",
        "model": f"MODEL: {best} is {rig}",
        "noise": f"NOISE: {lead}, with the same rig, and {noise}",
        "both": f"MODEL AND NOISE: {best} is {rig}, and {noise}",
        "either": f"MODEL OR NOISE, not told apart: {lead}, and another noise or another rig does about "
        "as well",
    }[decision.word]


def odds(log: float) -> str:
    """`1200`, or `e^35` where nobody counts."""
    if log > TIMES:
        return f"e^{log:.0f}"
    value = math.exp(log)
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def comparison_table(models: Sequence[RunSummary]) -> Table:
    """The most probable first."""
    top = max(model.log_z for model in models)
    order = sorted(range(len(models)), key=lambda k: -models[k].log_z)
    share = probabilities(models)
    held = _against_best([model.held_out for model in models], lambda model: model.score, "-")
    left_out = [model.loo if isinstance(model.loo, LooScore) else None for model in models]
    loo = _against_best(left_out, lambda score: score.elpd, "refused")
    lines = []
    for k in order:
        model = models[k]
        # Of the channel in which each is farthest from 1 or 0.
        sizes = (summary.rms for summary in model.residuals)
        rms = max(sizes, key=lambda x: abs(math.log(max(x, 1e-300))))
        correlation = max((summary.correlation for summary in model.residuals), key=abs)
        cells = {
            "model": model.name + ("" if model.converged else " (NOT CONVERGED)"),
            "unknowns": str(len(model.layer.problem.symbols)),
            "log evidence": verdict_words.evidence_said(model.evidence),
            "against best": f"{model.log_z - top:.1f}" if model.log_z < top else "best",
            "probability": f"{share[k]:.3g}" if share[k] > 1e-4 else "0",
            "held out": held[k],
            "LOO": loo[k],
            "rms": f"{rms:.3g}",
            "correlation": f"{correlation:.2g}",
        }
        lines.append(tuple(cells.values()))
    return Table(tuple(cells), tuple(lines), frozenset(("model",)))


def _against_best[S: (HeldOutScore, LooScore)](
    scores: Sequence[S | None], value: Callable[[S], float], none: str
) -> list[str]:
    """The difference of each to the one of the largest `value`; `none`: of those that have no score."""
    best = max((score for score in scores if score), key=value, default=None)
    cells = []
    for score in scores:
        if score is None or best is None:
            cells.append(none)
        else:
            apart, error = difference(score, best)
            cells.append("best" if apart == 0.0 else f"{apart:.1f} +- {error:.1f}")
    return cells


def predicted(models: Sequence[RunSummary]) -> Iterator[str]:
    """Where scores come from, and why there are none."""
    held = {model.name: model.held_out for model in models if model.held_out is not None}
    if held:
        best = max(held, key=lambda name: held[name].score)
        yield f"held out: {held[best].samples} samples, which {best} predicts best"
    else:
        yield (
            "held out: nothing. `record: {held_out: [from, to]}` [s] in all configs keeps a stretch of "
            "the record out of the fit, to be predicted. `held_out: true` does so for an experiment."
        )
    refused: dict[str, list[str]] = {}
    for model in models:
        if isinstance(model.loo, str):
            refused.setdefault(model.loo, []).append(model.name)
        elif model.loo.doubtful > MAX_BAD_SHARE:
            yield f"LOO of {model.name}: {model.loo.doubtful:.0%} of the samples lean on a few draws"
    for reason, names in refused.items():
        yield f"LOO refused for {', '.join(names)}: {reason}"


def comparison_csv(models: Sequence[RunSummary], rows: Sequence[OverlayRow]) -> str:
    """A line for each model in the order given: SI, all digits."""
    channels = list(dict.fromkeys(summary.name for model in models for summary in model.residuals))
    heads = ["model", "unknowns", "converged", "log_evidence", "log_evidence_error", "log_odds"]
    heads += ["probability", "held_out", "held_out_samples", "loo", "loo_refused"]
    heads += [f"{what}_{name}" for name in channels for what in ("rms", "correlation")]
    heads += [f"{row.symbol.name}_{what}" for row in rows for what in ("mean", "sd")]
    lines: list[Sequence[object]] = [heads]
    top, share, none = max(model.log_z for model in models), probabilities(models), (None, None)
    for k, model in enumerate(models):
        residuals = {each.name: (each.rms, each.correlation) for each in model.residuals}
        held, places = model.held_out, [row.places[k] for row in rows]
        said = [model.name, len(model.layer.problem.symbols), "yes" if model.converged else "no"]
        said += [model.log_z, model.evidence.error, model.log_z - top, share[k]]
        said += none if held is None else (held.score, held.samples)
        said += (None, model.loo) if isinstance(model.loo, str) else (model.loo.elpd, None)
        said += [x for name in channels for x in residuals.get(name, none)]
        said += [x for p in places for x in (none if p is None else (p.mean, p.sd))]
        lines.append(said)
    return lines_as_csv(lines)
