"""The verdict, the evidence, repeats and steps: in sentences, in tables, and as data."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from bayesdrill.analysis.comparison import RepeatedProduct
from bayesdrill.analysis.identifiability.structure import DependsOnFixed
from bayesdrill.analysis.plausibility import DiffusePrior
from bayesdrill.analysis.verdict import FALSE_ALARM, JUDGED, Quantity, Verdict
from bayesdrill.basics.symbols import Symbol, unit_product
from bayesdrill.inference.display_units import SI, DisplayUnits
from bayesdrill.inference.step_error import MAX_ERROR_OVER_NOISE, TRUTH_REFINEMENT, StepError
from bayesdrill.report import section
from bayesdrill.report.section import Table
from bayesdrill.report.sections.identify_words import percent, priors_of, product
from bayesdrill.report.sections.physics_words import listed
from bayesdrill.sampling.evidence import Evidence

POOR = 0.1  # error, from which on it is said to be rough

EVIDENCE_EXPLAINED = (
    "The log evidence is the natural log of how probable the samples are under the model, with all "
    "that its priors allow. By itself it says nothing. The difference of two models of one record is "
    "the log of their odds, if both were equally likely before (`bayesdrill compare`)."
)


def evidence_sentences(
    evidence: Evidence, priors: Sequence[DiffusePrior], *, converged: bool
) -> str:
    """A line, and one for what makes it doubtful."""
    lines = [f"log evidence: {evidence_said(evidence)}"]
    if evidence.steps_error:
        lines.append(
            f"  of which {evidence.steps:+.2g} +- {evidence.steps_error:.1g} for the error of its steps"
        )
    rough = ""
    if not converged:
        rough = "the ensembles did not converge"
    elif evidence.error > POOR and evidence.steps_error > 0.5 * evidence.error:
        rough = "the steps of the rig are long for it; a larger `model.pieces` helps"
    elif evidence.error > POOR:
        rough = "the proposal and the posterior have little in common; longer chains would help"
    if rough:
        lines.append(f"  ROUGH: {rough}")
    wide = [
        f"that of {prior.name} is {prior.times:.0f} times as wide as what was found is large"
        if prior.decades is None
        else f"that of {prior.name} is {prior.decades:.1f} decades wide"
        for prior in priors
    ]
    if wide:
        lines.append(
            f"  VAGUE PRIORS: {', '.join(wide)}. Each doubling of a range halves the evidence, and may "
            "hide all else when models are compared. Give these priors the range that you believe."
        )
    return "\n".join(lines)


def evidence_said(evidence: Evidence) -> str:
    """To as many digits as are known."""
    digits = max(0, min(4, -math.floor(math.log10(max(evidence.error, 1e-4)))))
    return f"{evidence.log_z:.{digits}f} +- {evidence.error:.1g}"


REPEATS_EXPLAINED = (
    "Each experiment alone, around the joint maximum: how far it puts a product from all of them "
    "together, and its own standard deviation. `spread` is what is left between experiments beyond that."
)


def repeats_sentence(repeats: Sequence[RepeatedProduct], names: Sequence[str]) -> str:
    """Whether the experiments agree; empty where there are not two that could differ."""
    if not repeats:
        return ""
    far = [repeat for repeat in repeats if repeat.differs]
    if not far:
        return (
            "experiments: as far as each can tell, all of them show the same rig "
            f"({len(repeats)} products compared)."
        )
    each = ", ".join(
        f"{product(names, repeat.exponents)} by {percent(repeat.spread)} (they know it to "
        f"{percent(min(repeat.sds))} to {percent(max(repeat.sds))})"
        for repeat in sorted(far, key=lambda repeat: repeat.p)
    )
    return (
        f"experiments: they do not show the same rig: {each}. The joint posterior is too sure. The rig "
        "changed between them, or the model lacks what differs. `own: [...]` lets a parameter differ."
    )


def repeats_table(repeats: Sequence[RepeatedProduct], names: Sequence[str]) -> Table:
    """A line for each product."""
    labels = list(dict.fromkeys(label for repeat in repeats for label in repeat.labels))
    heads = ("", *labels, "spread", "by chance")
    lines = []
    for repeat in repeats:
        cells = {
            label: f"{100 * apart:+.2g} % +- {percent(sd)}"
            for label, apart, sd in zip(repeat.labels, repeat.apart, repeat.sds, strict=True)
        }
        spread = percent(repeat.spread) if repeat.spread else "none"
        by_chance = "**no**" if repeat.differs else f"{repeat.p:.2g}"
        each = (cells.get(label, "") for label in labels)
        lines.append((product(names, repeat.exponents), *each, spread, by_chance))
    return Table(heads, tuple(lines), frozenset(("",)))


def step_sentences(errors: Sequence[StepError]) -> str:
    """A line for the worst of all steps that do no harm, and one for each of the others."""
    lines = []
    fine = sorted((error for error in errors if error.fine), key=lambda error: -error.worst)
    for error in (*fine[:1], *(error for error in errors if not error.fine)):
        where = f" in {error.label}" if error.label else ""
        if error.fine and len(fine) > 1:
            where += f", the worst of {len(fine)} experiments"
        steps = "one step" if error.pieces == 1 else f"{error.pieces} steps"
        named = zip(error.channels, error.errors, strict=True)
        each = ", ".join(f"{name} {size:.2g}" for name, size in named)
        moved = (
            f"{steps} to a sample{where}; {TRUTH_REFINEMENT} times as many would move samples by"
        )
        worst = f"{error.worst:.2g} of the noise ({each})"
        said = f"{moved} at most {worst}. That does no harm."
        if not error.fine:
            said = (
                f"TOO FEW: {moved} up to {worst}. At most a tenth of the noise does no harm. Say "
                f"`model: {{pieces: {steps_wanted(error)}}}`."
            )
        lines.append(f"steps: {said}")
    return "\n".join(lines)


def steps_wanted(error: StepError) -> int:
    """Pieces that are enough, of an error that falls as steps get shorter, the next power of two."""
    return error.pieces << max(1, math.ceil(math.log2(error.worst / MAX_ERROR_OVER_NOISE)))


SHORT = ("", "nominal", "mean", "dev. %", "tension", "beyond tol.", "bits", "verdict")

VERDICT_EXPLAINED = (
    "All in SI. First come products of powers, which the record can show, then the parameters by "
    "themselves. `dev. %` is the deviation of the posterior mean from the nominal value. `tension` says "
    "how many sigma the nominal value lies from the posterior, or the nearest value within its "
    "tolerance `tol. %`. `beyond tol.` is the probability that the deviation exceeds the tolerance. "
    "`sd/prior` is the standard deviation of the log over that of the prior. `bits` is the information "
    "gained on the prior: one bit halves a range."
)


_HOLDS = (
    "which the config holds fixed. If that is wrong by some factor, they are wrong too, and the fit is "
    "as good. A prior in its place shows what the record tells by itself"
)
_LEANS = "as the record by itself tells little but ratios"


def verdict_sentences(
    verdict: Verdict,
    table: str,
    *,
    converged: bool = True,
    believed: bool = True,
    records: int = 1,
    lacking: str = "",
    rests: Sequence[DependsOnFixed] = (),
    units: DisplayUnits = SI,
) -> str:
    """The whole in a sentence, then what it rests on, what is not determined and what is pressed.

    `believed`: whether the run may be; `records`: of how many experiments it is; `lacking`: what the
    model may miss.
    """
    if not believed:
        return no_verdict(converged=converged)
    lines = [verdict_sentence(verdict, table, records)]
    if not verdict.fits:
        missing = f" It may lack {lacking}, which would distort its parameters." if lacking else ""
        lines.append(
            "IN DOUBT: the verdict holds only if the model does. The fit leaves more than noise, which "
            f"is evidence against the model.{missing}"
        )
    lines += _resting(verdict, rests)
    return "\n".join([*lines, *_undecided(verdict, units)])


def no_verdict(*, converged: bool) -> str:
    """Of a run that must not be believed."""
    because = "the model does not fit" if converged else "the run did not converge"
    return f"verdict: none, because {because}. The numbers may be wrong."


def verdict_rule(verdict: Verdict) -> str:
    """What the verdict is worth."""
    return (
        f"*disagrees*: more than {verdict.limit:.2f} sigma. If the rig were as the table and its "
        f"tolerances say, at most {100 * FALSE_ALARM:g} % of records would show any disagreement, all "
        "quantities together. *In doubt*: as far, but the fit leaves more than noise: the model may "
        "be to blame and not the table. *Not determined*: the record leaves it to the prior, and so "
        "says nothing for or against the nominal value."
    )


def verdict_sentence(verdict: Verdict, table: str, records: int = 1) -> str:
    """Return the verdict: how much was determined, whether it agrees, and all taken together."""
    n, k = len(verdict.products), len(verdict.judged)
    determines, such, says = "this record determines", "such a record", "It says"
    if records > 1:
        determines, such, says = "these records determine", "such records", "They say"
    can = f"the {n} independent products of parameters that {such} can show"
    if not verdict.judged:
        none = f"{determines} none of {can}"
        if verdict.saying("cannot judge"):
            none = f"none of {can} can be judged"
        return f"verdict: {none}. {says} nothing of {table}."
    joint = together = ""
    if verdict.joint is not None:
        joint = f"taken together they are {_sigmas(verdict.joint)} from {table}"
        together = f" {joint[0].upper()}{joint[1:]}."
    opening = f"verdict: {determines} {k} of {can}."
    if n == 1:
        opening = f"verdict: {determines} the one quantity that is compared."
    if verdict.far:
        listed = ", ".join(
            f"{quantity_name(verdict, q)} ({100 * q.deviation:+.3g} %, {_sigmas(q.tension)})"
            for q in verdict.far
        )
        how = "disagree with" if verdict.fits else "would, if the model were right, disagree with"
        return f"{opening} These {how} {table}: {listed}.{together}"
    each = f"{opening} Each by itself agrees with {table}"
    if verdict.far_together and not verdict.fits:
        return f"{each}. If the model were right, {joint}, too far for chance."
    if not verdict.agrees:
        return f"{each}, but {joint}, too far for chance. The table does not describe this rig."
    if not verdict.fits:
        all_of_them = "it" if k == 1 else f"all {k}"
        return (
            f"{opening} If the model were right, {all_of_them} would agree with {table}.{together}"
        )
    agree = "It agrees" if k == 1 else f"All {k} agree"
    return f"{opening} {agree} with {table}.{together}"


def _resting(verdict: Verdict, rests: Sequence[DependsOnFixed]) -> list[str]:
    """What is judged only as far as a number is right that the config holds, or a prior."""
    judged = [q for q in verdict_rows(verdict) if q.says in JUDGED]
    lines: dict[tuple[str, str], list[str]] = {}
    for dependence in rests:
        for q in judged:
            if dependence.scales(verdict.names, q.exponents):
                priors = dependence.priors(verdict.names, q.exponents)
                basis = (
                    (priors_of(priors), _LEANS) if priors else (listed(dependence.through), _HOLDS)
                )
                lines.setdefault(basis, []).append(quantity_name(verdict, q))
    return [
        f"{listed(names)} {'depend' if len(names) > 1 else 'depends'} on {on}, {why}."
        for (on, why), names in lines.items()
    ]


def _undecided(verdict: Verdict, units: DisplayUnits) -> Iterator[str]:
    open_ones = verdict.saying("not determined")
    ends = [f"of {name} ends at {units.format_value(name, e)}" for name, e in verdict.ends.items()]
    reasons = {
        "Not determined by themselves": (
            [q for q in open_ones if q.blind],
            "No record of these channels can tell them apart: some of them can be multiplied by one "
            "factor, and no measured signal changes. Only their products count.",
        ),
        "Not determined": (
            [q for q in open_ones if not q.blind],
            "This record says almost nothing about them: their values are mostly those of the prior. A "
            "longer or cleaner record could show them.",
        ),
        "At an end of its prior": (
            verdict.saying("pressed against the prior"),
            "The end decides there, so nothing is said of the nominal value.",
        ),
        "Cannot judge": (
            verdict.saying("cannot judge"),
            f"The prior {', that '.join(ends)}; widen it. Hardly a draw can lie beyond, whatever the "
            "record says of the nominal value.",
        ),
    }
    for said, (quantities, why) in reasons.items():
        if quantities:
            yield f"{said}: {', '.join(quantity_name(verdict, q) for q in quantities)}. {why}"


def verdict_rows(verdict: Verdict) -> tuple[Quantity, ...]:
    """Products, then parameters that are not among them."""
    shown = {quantity.exponents for quantity in verdict.products}
    return (*verdict.products, *(q for q in verdict.parameters if q.exponents not in shown))


def verdict_table(verdict: Verdict) -> Table:
    """Tolerances only where there are any."""
    lines = []
    for quantity in verdict_rows(verdict):
        low, high = (100 * end for end in quantity.tolerance)
        cells = {
            "": quantity_name(verdict, quantity),
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


def verdict_csv(verdict: Verdict, symbols: Sequence[Symbol]) -> str:
    """All digits, SI, units by `symbols`; deviation, tolerances, probabilities are fractions."""
    units = {symbol.name: symbol.unit for symbol in symbols}
    heads = ("quantity", "unit", "nominal", "tolerance_low", "tolerance_high", "mean", "sd")
    more = ("deviation", "tension_sigma", "beyond_tolerance", "sd_ratio", "bits", "verdict")
    lines = [
        (
            quantity_name(verdict, q),
            unit_product([units[name] for name in verdict.names], q.exponents),
            *(q.nominal, *q.tolerance, q.mean, q.sd, q.hdi_low, q.hdi_high),
            *(q.deviation, q.tension, q.beyond, q.sd_ratio, q.bits, q.says),
        )
        for q in verdict_rows(verdict)
    ]
    return section.lines_as_csv([(*heads, *section.HDI_ENDS, *more), *lines])


def _sigmas(x: float) -> str:
    return f"{round(x, 1) + 0.0:.1f} sigma" if x < 10 else f"{x:.0f} sigma"  # never -0.0


def quantity_name(verdict: Verdict, quantity: Quantity) -> str:
    """Return the name of a product, such as `k_s/j_1`."""
    return product(verdict.names, quantity.exponents)
