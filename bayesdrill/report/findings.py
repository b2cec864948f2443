"""Describe findings of an analysis in sentences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import starmap

from bayesdrill.basics.errors import count_noun
from bayesdrill.basics.findings import Finding

IDEAL_MOTOR = (
    "In SI units the two are equal in an ideal motor, and losses make {constant} the smaller one. "
    "Check {constant}, {back_emf}, the supply and the gear reduction"
)
POWER_OF_DRAWS = (
    "energy: {constant} is more than {margin:g} % above {back_emf} in {percent:.3g} % of the draws "
    "(median ratio {ratio:.3g}). Such a motor would give more power than it takes up, which none does. "
)
FOLLOWED = (
    "the residuals of {channel} follow the input {input}, {late} ({seconds:.3g} s) after it "
    "(correlation {correlation:.2g}, chance gives at most {chance:.2g})"
)
AT_WALKER = (
    "walker {walker:.0f} of ensemble {ensemble:.0f}, at {unknown} {mean:.4g} where the others have "
    "{centre:.4g} +- {sd:.2g} in SI"
)
MISSED = (
    "coverage: about {{percent:.2g}} % of the posterior lies where the proposal hardly ever draws, "
    "so {}; narrow the priors that span decades"
)
NEIGHBOURS = "neighbours predict a sample that is left out"
# The keys are kinds of findings; `_phrases` makes the phrases that only some findings need.
SENTENCES: Mapping[str, str] = {
    "unlikely nominal value": (
        "the nominal value {value:.4g} of {name} is far outside its prior, of which all but "
        "{percent:g} % is between {low:.4g} and {high:.4g}. The value, the prior or a unit is wrong"
    ),
    "states without roles": (
        "roles: {model} gives no role to {states}. Friction, energy and missing torques are "
        "not checked there. Name the missing roles in the rig's `roles`"
    ),
    "another gear": (
        "{channel} measures {times:g} * {state}, but {fast} {moves} {ratio:.4g} times as fast as "
        "{behind} ({entry}). One of the two factors is wrong for this rig"
    ),
    "friction that drives": (
        "friction: in {percent:.3g} % of the record {inertia} {moves} the other way, and {friction}, "
        "which keeps its sign, drives instead of braking. Cut these samples off (record.window). If it "
        "always {moves} in this direction, turn the signs of {drives} and of all channels. Or hold "
        "{friction} at 0 and name {sliding}, friction that changes its sign"
    ),
    "servo that saturates": (
        "servo: {motor} saturates in {percent:.3g} % of the record, at a duty cycle of {duty:.3g} "
        "({limit}). Only these samples show {limit}, and they show nothing of the loop"
    ),
    "servo beyond its supply": (
        "servo: {motor} would need more than its whole supply in {percent:.3g} % of the record. Name "
        "{limit}, its largest duty cycle, so that it saturates there"
    ),
    "power of nominal values": (
        "energy: {constant} = {constant_value:.4g} {newtons}/A is {ratio:.3g} times {back_emf} = "
        "{back_emf_value:.4g} V s/{angle}. The motor would give {ratio:.3g} times the power that it "
        "takes up. "
    )
    + IDEAL_MOTOR,
    "power of draws": POWER_OF_DRAWS + IDEAL_MOTOR,
    "power of priors": POWER_OF_DRAWS
    + "The record cannot show this ratio: it is what the priors and the fixed values allow",
    "geometry": (
        "geometry: {name} = {value:.4g} {unit} is {percent:+.0f} % off what the paper's dimensions "
        "give: {part} {expected:.3g} {unit}"
    ),
    "unstable pole": (
        "stability: a pole lies in the right half plane{draws}, with a real part of up to {pole:.3g} "
        "1/s: the rig would run away by itself"
    ),
    "fast decay": (
        "sampling: the fastest motion dies out within {decay_ms:.3g} ms (pole at {pole:.3g} 1/s), but "
        "the record has a sample every {step_ms:.3g} ms{draws}. The time constant of this motion"
        "{mostly} shows only through slower motions"
    ),
    "fast oscillation": (
        "sampling: an oscillation of {frequency:.3g} Hz is faster than half of the {rate:.4g} samples "
        "per second{draws}: the record shows a false frequency"
    ),
    "unit against the start": (
        "unit: {channel} is {times:.3g} times what the start values predict; was it {mistakes}? See its "
        "unit, its column and `measures`"
    ),
    "size against the start": (
        "REVIEW: {seen}. {cure}. See the "
        "lines of nominal and held values, and the units of columns and inputs"
    ),
    "unit of an angle": (
        "unit: {angle} grows {times:.3g} times as fast as {speed} says; is one of them {mistakes}? See "
        "their units, columns and `measures`"
    ),
    "swapped columns": (
        "columns: {speed} grows like the integral of {angle} over time, but {angle} does not grow like "
        "that of {speed}; are the two columns swapped?"
    ),
    "overflow": (
        "overflow: {channel} jumps by about {period:.6g}, {range}, {often}, first at "
        "{first:.6g} s; a counter that overflowed? Write wraps: {period:.6g} at {channel}, or unwrap "
        "the column: np.unwrap(x, period={period:.6g})"
    ),
    "delay and time constant": (
        "timing: {delay_name} and a time constant cannot be distinguished (correlation "
        "{correlation:.3f}): {delay:.3g} ms, sd {delay_sd:.2g}, and {tau:.3g} ms, sd {tau_sd:.2g}. Hold "
        "the delay if it is known, or record faster changes of the input"
    ),
    "nothing moved": (
        "nothing moved: every row has the same {channels}. Mend the sensor and record again, or name "
        "another column"
    ),
    "still channel": (
        "still: {channel} is the same in every row, while other channels move. Mend the sensor, name "
        "another column, or leave it out"
    ),
    "zeros between": (
        "zeros: in {channel} only one cell in {period:.0f} is not zero, as in the column of a slower "
        "sensor. Leave the other cells blank, and say missing: drop"
    ),
    "repeated cells": (
        "repeated: {channel} holds each value for {period:.0f} rows, so its noise would count "
        "{period:.0f} times. Say decimate: {{factor: {period:.0f}, filter: false}}, or leave the "
        "repeated cells blank and say missing: drop"
    ),
    "opposite signs": (
        "sign: {channel} goes against {input}. If its sensor counts backwards, turn the sign of "
        "`measures:`. If the input does, say gain: -1 at {input}"
    ),
    "unit of a goal": (
        "unit: {channel} moves {times:.3g} times as far as {input}, which it follows. Correct the unit "
        "of one of them"
    ),
    "speed falls": (
        "sign: {channel} falls as {input} rises, though both keep their sign. One of the columns is "
        "another quantity, or the record lacks a load that changes"
    ),
    "channel turned": (
        "sign: {channel} turns against {other}. If its sensor counts backwards, turn the sign of "
        "`measures:`"
    ),
    "one direction": (
        "one direction: {channel} never turns back, so {offset} cannot be distinguished from "
        "{frictions}. Record the other direction too, or hold one of them"
    ),
    "anomaly": "{text}",
    "differentiated angle": (
        "derived: the noise of {speed} is that of differences of {angle}. If {speed} was computed from "
        "{angle}, it must not count twice: say derived_from: {angle} at {speed}, or leave it out"
    ),
    "residuals after an input": FOLLOWED,
    "residuals before an input": FOLLOWED + ": the input reacts to the rig, or times are off",
    "walkers that hardly move": (
        "{count:.0f} of {walkers:.0f} walkers did not move for {share:.0%} of {steps:.0f} steps or "
        "longer: the moves do not suit this posterior. Change the shares in sampler.moves"
    ),
    "stuck walkers": (
        "{counted} stuck: the longest did not move for {stay:.0f} of {steps:.0f} steps ("
        + AT_WALKER
        + "). Start over with another seed. If a walker is stuck there again, check the model at these "
        "values"
    ),
    "walkers at a low density": (
        "{counted} far from where the posterior is: log density {density:.1f}, the others' {others:.1f} "
        "("
        + AT_WALKER
        + "). This is a lower maximum, or the chain has not reached the posterior yet. Start over with "
        "another seed, or exclude these values by an end of the prior"
    ),
    "two groups of walkers": (
        "the walkers sit in two places and hardly ever cross between them (SI; {places} by "
        "{walkers:.0f} walkers in {steps:.0f} steps). The shares are those of the start, not of the "
        "posterior. Exclude one place by an end of the prior, or add a record that distinguishes the "
        "two"
    ),
    "growing autocorrelation time": (
        "the autocorrelation time of {unknown} still grows with the chain: estimates are {quarter:.0f} "
        "steps from quarters of the chain, {half:.0f} from halves and {whole:.0f} from all of it. The "
        "usual estimate, {tau:.0f} steps, is too small. The chain is at most {times:.0f} "
        "autocorrelation times long, which is too short"
    ),
    "burn-in too short to judge": (
        "the run is too short to judge its burn-in: {taus:.0f} autocorrelation times are {wanted:.0f} "
        "steps, half of the run is {burn_in:.0f}"
    ),
    "the ensembles disagree": (
        "the ensembles disagree on {unknown}: R-hat {r_hat:.4f}, wanted at most {wanted:g}"
    ),
    "the chain is too short": (
        "the chain is {n_tau:.0f} autocorrelation times long (tau {tau:.0f} steps, {unknown}), wanted "
        "at least {wanted:g}"
    ),
    "too few effective draws": (
        "{ess:.0f} effective draws of {unknown}, wanted at least {wanted:g}"
    ),
    "stopped early, as tau grows": (
        "stopped early: tau grows with the chain. It was {tau:.0f} at step {steps:.0f} and is "
        "{late_tau:.0f} at step {late_steps:.0f}. More steps do not help. Hold an unknown, narrow the "
        "priors, or check whether the model can produce this record at all"
    ),
    "more steps than max_steps": (
        "stopped early: it would take about {needed:.0f} steps, more than sampler.max_steps "
        "({most:.0f}). Raise max_steps and continue with --resume, or hold an unknown"
    ),
    "more steps than fit in memory": (
        "stopped early: it would take about {needed:.0f} steps, more than {most:.0f}, the limit for a "
        "chain with this number of walkers and unknowns. Lower sampler.walkers, or hold an unknown"
    ),
    "more maxima than were followed": (
        "the search for maxima stopped after {maxima:.0f} maxima: others, which the record cannot "
        "distinguish from these, may hold about {missed:.0%} of the posterior. Narrow the priors, or "
        "hold an unknown"
    ),
    "some missed": MISSED.format("the ends of intervals are rough"),
    "much missed": MISSED.format("all numbers are rough"),
    "too many samples to leave out": "more than {most:.0f} samples",
    "noise with memory": f"its noise is correlated: {NEIGHBOURS}",
    "residuals with memory": (
        "its residuals are not white (correlation of neighbours {correlation:.2f} in {channel}): "
        f"{NEIGHBOURS}"
    ),
    "nothing sampled": "nothing could be sampled: {why}",
    "ranks outside the band": "ranks of {quantity} leave the band{reason}",
    "intervals of a wrong share": (
        "{percent:.3g} % intervals of {quantity} hold the truth in {inside:.0f} % of the refits"
    ),
    "refits not converged": (
        "{count:.0f} of {refits:.0f} refits did not converge (allowed: at most {most:g} %)"
    ),
    "refits without draws": "{count:.0f} of {refits:.0f} refits gave no draws at all",
}


def finding_sentences(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the sentence of each finding."""
    return tuple(map(finding_sentence, findings))


def finding_sentence(finding: Finding) -> str:
    """Return the sentence of a finding; it begins with the label of its experiment, if any."""
    names, numbers = finding.names, finding.numbers
    phrases = _phrases(finding)
    if finding.kind == "two groups of walkers":
        phrases["places"] = "; ".join(starmap(_place, finding.rows.items()))
    said = SENTENCES[finding.kind].format(**names, **numbers, **phrases)
    return f"{names['experiment']}, {said}" if "experiment" in names else said


def _phrases(finding: Finding) -> dict[str, str]:
    """Return phrases for a sentence by name; most are empty if the finding lacks their numbers."""
    names, numbers, rows = finding.names, finding.numbers, finding.rows
    of_draws = f" (in {numbers['percent']:.3g} % of the draws)" if "percent" in numbers else ""
    walkers = ""
    if counts := rows.get("ensembles"):
        where = ", ".join(f"{count:.0f} in ensemble {k}" for k, count in enumerate(counts) if count)
        verb = "is" if sum(counts) == 1 else "are"
        walkers = f"{sum(counts):.0f} of {numbers['walkers']:.0f} walkers ({where}) {verb}"
    lag = numbers.get("lag", 0.0)
    seen = "not what the start values predict"
    if names.get("channel"):
        seen = f"{numbers.get('times', 1.0):.3g} times as large as the start values predict"
    cure = "A value or a unit may be off by a factor"
    if names.get("factor"):
        cure = f"With {names['factor']} times the value of {names['value']} the model nearly fits"
    return {
        "cure": cure,
        "seen": f"{names.get('channel') or 'the record'} is {seen}",
        "draws": of_draws,
        "late": f"{lag:+.0f} sample" if abs(lag) == 1.0 else f"{lag:+.0f} samples",
        "often": count_noun(round(numbers.get("jumps", 0.0)), "time"),
        "mostly": f", mostly due to {names['constants']}," if names.get("constants") else "",
        "reason": f" ({names['shape']})" if names.get("shape") else "",
        "counted": walkers,
    }


def _place(unknown: str, row: tuple[float, ...]) -> str:
    low, high, upper, crossings = row
    return (
        f"{unknown}: {1 - upper:.1%} of the draws near {low:.4g}, {upper:.1%} near {high:.4g}, "
        f"{count_noun(round(crossings), 'crossing')}"
    )
