"""Put findings of an analysis into sentences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from bayesdrill.analysis.findings import Finding

IDEAL_MOTOR = (
    "In SI units the two are equal in an ideal motor, and losses make {constant} the smaller one. "
    "Check {constant}, {back_emf}, the supply and the gear reduction"
)
POWER_OF_DRAWS = (
    "energy: {constant} is more than {margin:g} % above {back_emf} in {percent:.3g} % of the draws "
    "(median ratio {ratio:.3g}). Such a motor would give more power than it takes up, which none does. "
)
# By kind of finding; `{draws}` and `{mostly}` are left empty where nothing is known of them.
SENTENCES: Mapping[str, str] = {
    "unlikely nominal value": (
        "the nominal value {value:.4g} of {name} is far outside its prior, which goes from {low:.4g} to "
        "{high:.4g} with all but {percent:g} % of it. One of the two, or its unit, is wrong"
    ),
    "states without roles": (
        "roles: {model} does not say what {states} is to it. Friction, energy and missing torques are "
        "not checked there. Name it in the rig's `roles`"
    ),
    "another gear": (
        "{channel} measures {times:g} * {state}, but {fast} {moves} {ratio:.4g} times as fast as "
        "{behind} ({entry}). One of the two is wrong for this rig"
    ),
    "friction that drives": (
        "friction: in {percent:.3g} % of the record {inertia} {moves} the other way, and {friction}, "
        "which keeps its sign, drives instead of braking. Cut these samples off (record.window). If it "
        "always {moves} so, turn the signs of {drives} and of all channels. Or hold {friction} at 0 and "
        "name {sliding}, friction that changes its sign"
    ),
    "servo that saturates": (
        "servo: {motor} saturates in {percent:.3g} % of the record, at a duty cycle of {duty:.3g} "
        "({limit}). Only there the record shows {limit}, and there it shows nothing of the loop"
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
        "give; {part} {expected:.3g} {unit}"
    ),
    "unstable pole": (
        "stability: a pole lies in the right half plane{draws}, at most {pole:.3g} 1/s: the rig would "
        "run away by itself"
    ),
    "fast decay": (
        "sampling: the fastest motion dies out within {decay_ms:.3g} ms (pole at {pole:.3g} 1/s), the "
        "record has a sample every {step_ms:.3g} ms{draws}. What sets it{mostly} is seen only through "
        "slower motions"
    ),
    "fast oscillation": (
        "sampling: an oscillation of {frequency:.3g} Hz is faster than half of the {rate:.4g} samples "
        "per second{draws}: the record shows a false frequency"
    ),
    "unit against the start": (
        "unit: {channel} is {times:.3g} times what the start values predict; was it {mistakes}? See its "
        "unit, its column and `measures`"
    ),
    "unit of an angle": (
        "unit: {angle} grows {times:.3g} times as fast as {speed} says; is one of them {mistakes}? See "
        "their units, columns and `measures`"
    ),
    "swapped columns": (
        "columns: {speed} grows as the sum of {angle} over time would, and not the other way round; are "
        "the two columns swapped?"
    ),
    "overflow": (
        "overflow: {channel} jumps by about {period:.6g}, {range}, {jumps:.0f} times, first at "
        "{first:.6g} s; a counter that ran over? Say wraps: {period:.6g} at {channel}, or unwrap the "
        "column: np.unwrap(x, period={period:.6g})"
    ),
    "differentiated angle": (
        "derived: the noise of {speed} is that of differences of {angle}. If it is no measurement of "
        "its own, it must not count twice: say derived_from: {angle} at {speed}, or leave it out"
    ),
}


def finding_sentences(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the sentence of each finding."""
    sentences = []
    for finding in findings:
        names, numbers = finding.names, finding.numbers
        share = f" (in {numbers['percent']:.3g} % of the draws)" if "percent" in numbers else ""
        mostly = f", mostly {names['constants']}," if names.get("constants") else ""
        words = SENTENCES[finding.kind]
        sentences.append(words.format(**names, **numbers, draws=share, mostly=mostly))
    return tuple(sentences)
