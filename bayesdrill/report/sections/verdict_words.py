"""The verdict, the evidence, repeats and steps: in sentences, in tables, and as data."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from bayesdrill.analysis.comparison import Repeat
from bayesdrill.analysis.identifiability.structure import Resting
from bayesdrill.analysis.plausibility import Vague
from bayesdrill.analysis.verdict import FALSE_ALARM, Quantity, Verdict
from bayesdrill.basics.symbols import Symbol, unit_product
from bayesdrill.inference.step_error import MAX_ERROR_OVER_NOISE, TRUTH_REFINEMENT, StepError
from bayesdrill.report import section
from bayesdrill.report.section import Table
from bayesdrill.report.sections.identify_words import percent, priors_of, product
from bayesdrill.report.sections.physics_words import listed
from bayesdrill.sampling.ensembles import Opened
from bayesdrill.sampling.evidence import Evidence

POOR = 0.1  # error, from which on it is said to be rough

EVIDENCE_EXPLAINED = (
    "The log evidence is the natural log of how probable this very record is under the model with all "
    "that its priors allow, not just its best fit. By itself it says nothing; the difference of two "
    "models of the same record is the log of their odds, where both were thought as likely before "
    "(`bayesdrill compare`)."
)


def evidence_sentences(found: Evidence, priors: Sequence[Vague], *, converged: bool) -> str:
    """A line, and one for what makes it doubtful."""
    lines = [f"log evidence: {evidence_said(found)}"]
    if found.steps_error:
        lines.append(
            f"  of which {found.steps:+.2g} +- {found.steps_error:.1g} for the error of its steps"
        )
    if not converged:
        lines.append("  ROUGH: the ensembles did not converge")
    elif found.error > POOR and found.steps_error > 0.5 * found.error:
        lines.append("  ROUGH: the steps of the rig are long for it; a larger `model.pieces` helps")
    elif found.error > POOR:
        lines.append(
            "  ROUGH: the proposal and the posterior have little in common; longer chains would help"
        )
    wide = [
        f"that of {one.name} is {one.times:.0f} times as wide as what was found is large"
        if one.decades is None
        else f"that of {one.name} is {one.decades:.1f} decades wide"
        for one in priors
    ]
    if wide:
        lines.append(
            f"  VAGUE PRIORS: {', '.join(wide)}: each halves the evidence as often as "
            "its range is doubled, and little else may be seen in a comparison with a model that is "
            "without it; give it the range that you believe"
        )
    return "\n".join(lines)


def evidence_said(found: Evidence) -> str:
    """To as many digits as are known."""
    digits = max(0, min(4, -math.floor(math.log10(max(found.error, 1e-4)))))
    return f"{found.log_z:.{digits}f} +- {found.error:.1g}"


REPEATS_EXPLAINED = (
    "Each experiment alone, around the joint maximum: how far it puts a product from all of them "
    "together, and its own standard deviation. `spread` is what is left between experiments beyond that."
)


def repeats_sentence(found: Sequence[Repeat], names: Sequence[str]) -> str:
    """Whether the experiments agree; empty where there are not two that could differ."""
    if not found:
        return ""
    far = [one for one in found if one.differs]
    if not far:
        return (
            "experiments: they tell the same of the rig, as far as each knows it "
            f"({len(found)} products compared)"
        )
    each = ", ".join(
        f"{product(names, one.exponents)} by {percent(one.spread)} (they know it to "
        f"{percent(min(one.sds))} to {percent(max(one.sds))})"
        for one in sorted(far, key=lambda one: one.p)
    )
    return (
        f"experiments: they do not tell the same of the rig: {each}; the joint posterior is too sure. "
        "The rig changed between them, or the model lacks what differs; `own: [...]` lets a parameter "
        "differ"
    )


def repeats_table(found: Sequence[Repeat], names: Sequence[str]) -> Table:
    """A line for each product."""
    labels = list(dict.fromkeys(label for one in found for label in one.labels))
    heads = ("", *labels, "spread", "by chance")
    lines = []
    for one in found:
        cells = {
            label: f"{100 * apart:+.2g} % +- {percent(sd)}"
            for label, apart, sd in zip(one.labels, one.apart, one.sds, strict=True)
        }
        spread = percent(one.spread) if one.spread else "none"
        by_chance = "**no**" if one.differs else f"{one.p:.2g}"
        each = (cells.get(label, "") for label in labels)
        lines.append((product(names, one.exponents), *each, spread, by_chance))
    return Table(heads, tuple(lines), frozenset(("",)))


def step_sentences(found: Sequence[StepError]) -> str:
    """A line for each experiment; nothing of a rig that needs no steps."""
    return "\n".join(map(_step_sentence, found))


def _step_sentence(one: StepError) -> str:
    where = f" in {one.label}" if one.label else ""
    steps = "one step" if one.pieces == 1 else f"{one.pieces} steps"
    each = ", ".join(
        f"{name} {error:.2g}" for name, error in zip(one.channels, one.errors, strict=True)
    )
    measured = f"{steps} to a sample{where}; {TRUTH_REFINEMENT} times as many would move samples by"
    worst = f"{one.worst:.2g} of the noise ({each})"
    if one.fine:
        return f"steps: {measured} at most {worst}, which does no harm"
    return (
        f"steps: TOO FEW: {measured} up to {worst}, and a tenth of it is what may be; say "
        f"`model: {{pieces: {steps_wanted(one)}}}`"
    )


def steps_wanted(one: StepError) -> int:
    """Pieces that are enough, of an error that falls as steps get shorter, the next power of two."""
    return one.pieces << max(1, math.ceil(math.log2(one.worst / MAX_ERROR_OVER_NOISE)))


SHORT = ("", "nominal", "mean", "dev. %", "tension", "beyond tol.", "bits", "verdict")

VERDICT_EXPLAINED = (
    "SI; products of powers first, which the record can show, then the parameters by themselves. "
    "`dev. %` is the deviation of the posterior mean from the nominal value; `tension` says how many "
    "sigma the nominal value, or the nearest one within its tolerance `tol. %`, lies from the "
    "posterior; `beyond tol.` is the probability that the deviation exceeds the tolerance; "
    "`sd/prior` the standard deviation of the log over the prior's; `bits` the information gained on "
    "the prior (one bit halves a range)."
)


_HOLDS = (
    "held: were that another number, so would these be, and the record would look the same; a prior "
    "instead says what it tells by itself"
)
_LEANS = "the record by itself tells little but ratios"

_NONE = "verdict: none, because {}; the numbers may be wrong"


def verdict_sentences(
    found: Verdict,
    table: str,
    *,
    converged: bool = True,
    believed: bool = True,
    records: int = 1,
    lacking: str = "",
    rests: Sequence[Resting] = (),
) -> str:
    """The whole in a sentence, then what it rests on, what is not determined and what is pressed.

    `believed`: whether the run may be; `records`: of how many experiments it is; `lacking`: what the
    model may miss.
    """
    if not believed:
        return no_verdict(converged=converged)
    whole = [verdict_sentence(found, table, records)]
    if not found.fits:
        missing = f": it may miss {lacking}, which would bend what it has" if lacking else ""
        whole.append(
            "IN DOUBT: the verdict holds only if the model does, and the fit, which leaves more than "
            f"noise, is evidence against the model{missing}"
        )
    more = _resting(found, rests)
    if found.opened:
        more.append(
            f"sigmas are counted with the priors of {', '.join(found.opened)} opened where they end, "
            "too near to the nominal values: no draw could lie beyond"
        )
    more += _not_determined(found)
    pressed = [quantity_name(found, q) for q in found.saying("pressed against the prior")]
    if pressed:
        more.append(
            f"pressed against the prior: {', '.join(pressed)} (the end of the prior decides, so nothing "
            "is said of the nominal value)"
        )
    return "\n".join([*whole, *more])


def no_verdict(*, converged: bool) -> str:
    """Of a run that must not be believed."""
    return _NONE.format("the model does not fit" if converged else "the run did not converge")


def verdict_rule(found: Verdict) -> str:
    """What the verdict is worth."""
    return (
        f"*disagrees*: more than {found.limit:.2f} sigma. Were the rig as the table and its tolerances "
        f"say, at most {100 * FALSE_ALARM:g} % of records would give any disagreement, all quantities "
        "taken together. *In doubt*: as far, but the fit leaves more than noise, so that the model may "
        "be to blame and not the table. *Not determined*: the record leaves it to the prior, and so "
        "says nothing for or against the nominal value."
    )


def verdict_sentence(found: Verdict, table: str, records: int = 1) -> str:
    judged = [q for q in found.products if q.says != "not determined"]
    n, k = len(found.products), len(judged)
    determines, such, says = "this record determines", "such a record", "it says"
    if records > 1:
        determines, such, says = "these records determine", "such records", "they say"
    can = f"the {n} independent products of parameters that {such} can show"
    if not judged:
        return f"verdict: {determines} none of {can}; {says} nothing of {table}"
    far = found.far
    joint = found.joint
    together = "" if joint is None else f"; taken together they are {_sigmas(joint)} from {table}"
    opening = f"verdict: {determines} {k} of {can}"
    if n == 1:
        opening = f"verdict: {determines} the one quantity that is compared"
    if far:
        listed = ", ".join(
            f"{quantity_name(found, q)} ({100 * q.deviation:+.3g} %, {_sigmas(q.tension)})"
            for q in far
        )
        how = "disagree" if found.fits else "would disagree, were the model right,"
        return f"{opening}; with {table} {how} {listed}{together}"
    if found.far_together and not found.fits:
        return (
            f"{opening}; each by itself agrees with {table}, but, were the model right, {together[2:]}, "
            "too far for chance"
        )
    if not found.agrees:
        return (
            f"{opening}; each by itself agrees with {table}, but {together[2:]}, too far for chance: "
            "the table does not describe this rig"
        )
    if not found.fits:
        every = "it" if k == 1 else f"all {k}"
        return f"{opening}; were the model right, {every} would agree with {table}{together}"
    every = "it agrees" if k == 1 else f"all {k} agree"
    return f"{opening}; {every} with {table}{together}"


def _resting(found: Verdict, rests: Sequence[Resting]) -> list[str]:
    """What is judged only as far as a number is right that the config holds, or a prior."""
    judged = [q for q in verdict_rows(found) if q.says != "not determined"]
    lines: dict[tuple[str, str], list[str]] = {}
    for one in rests:
        for q in judged:
            if one.scales(found.names, q.exponents):
                priors = one.priors(found.names, q.exponents)
                basis = (priors_of(priors), _LEANS) if priors else (listed(one.through), _HOLDS)
                lines.setdefault(basis, []).append(quantity_name(found, q))
    return [f"resting on {on}: {', '.join(names)} ({why})" for (on, why), names in lines.items()]


NOT_KEPT = (
    "not there: a run of an older version has not kept its draws beyond the ends of priors, and tables "
    "cannot be followed without them; `--resume`, or under another version `--force`, samples them"
)


def not_kept(beyond: Opened | None) -> Iterator[str]:
    """Of a run that has left nothing of what lies beyond ends of priors."""
    if beyond is not None and not beyond.kept:
        yield (
            f"priors of {', '.join(beyond.names)} end near nominal values, and draws beyond were not "
            "kept by the version that sampled this run, so that nothing is said of these values: "
            "continue it with --resume, or under another version start over with --force"
        )


def _not_determined(found: Verdict) -> list[str]:
    open_ones = found.saying("not determined")
    blind = [quantity_name(found, q) for q in open_ones if q.blind]
    weak = [quantity_name(found, q) for q in open_ones if not q.blind]
    lines = []
    if blind:
        lines.append(
            f"not determined by themselves: {', '.join(blind)} (no such record can tell them apart: "
            "changed together they leave every measured signal as it is; only the products above count)"
        )
    if weak:
        lines.append(
            f"not determined: {', '.join(weak)} (a longer or cleaner record could show them; this one "
            "leaves them mostly to the prior)"
        )
    return lines


def verdict_rows(found: Verdict) -> tuple[Quantity, ...]:
    """Products, then parameters that are not among them."""
    shown = {quantity.exponents for quantity in found.products}
    return (*found.products, *(q for q in found.parameters if q.exponents not in shown))


def verdict_table(found: Verdict) -> Table:
    """Tolerances only where there are any."""
    lines = []
    for quantity in verdict_rows(found):
        low, high = (100 * end for end in quantity.tolerance)
        cells = {
            "": quantity_name(found, quantity),
            "nominal": f"{quantity.nominal:.4g}",
            "tol. %": f"{low:+.3g} to {high:+.3g}" if high > low else "",
            "mean": f"{quantity.mean:.4g}",
            "sd": f"{quantity.sd:.2g}",
            section.HDI: f"{quantity.hdi_low:.4g} to {quantity.hdi_high:.4g}",
            "dev. %": f"{100 * quantity.deviation:+.3g}",
            "tension": _sigmas(quantity.tension).removesuffix(" sigma"),
            "beyond tol.": "" if quantity.beyond is None else f"{100 * quantity.beyond:.1f} %",
            "sd/prior": f"{quantity.sd_ratio:.2g}",
            "bits": f"{quantity.bits:.1f}",
            "verdict": quantity.says,
        }
        lines.append(tuple(cells.values()))
    table = Table(tuple(cells), tuple(lines), frozenset(("", "verdict")), brief=SHORT)
    return table.filled("tol. %", "beyond tol.")


def verdict_csv(found: Verdict, symbols: Sequence[Symbol]) -> str:
    """All digits, SI; deviation, tolerances and probabilities are fractions.

    `symbols` of the unknowns.
    """
    units = {symbol.name: symbol.unit for symbol in symbols}
    heads = ("quantity", "unit", "nominal", "tolerance_low", "tolerance_high", "mean", "sd")
    more = ("deviation", "tension_sigma", "beyond_tolerance", "sd_ratio", "bits", "verdict")
    lines = [
        (
            quantity_name(found, q),
            unit_product([units[name] for name in found.names], q.exponents),
            *(q.nominal, *q.tolerance, q.mean, q.sd, q.hdi_low, q.hdi_high),
            *(q.deviation, q.tension, q.beyond, q.sd_ratio, q.bits, q.says),
        )
        for q in verdict_rows(found)
    ]
    return section.lines_as_csv([(*heads, *section.HDI_ENDS, *more), *lines])


def _sigmas(x: float) -> str:
    return f"{x:.1f} sigma" if x < 10 else f"{x:.0f} sigma"


def quantity_name(found: Verdict, quantity: Quantity) -> str:
    return product(found.names, quantity.exponents)
