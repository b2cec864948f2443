"""Compare the posterior with the nominal table, and one experiment with the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bayesdrill.analysis.comparison import RepeatedProduct
from bayesdrill.analysis.identifiability.structure import DependsOnFixed
from bayesdrill.analysis.verdict import FALSE_ALARM, JUDGED, Quantity, Verdict
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import count_noun
from bayesdrill.basics.symbols import Symbol, product_latex, unit_product
from bayesdrill.inference.display_units import SI, DisplayedUnknowns, DisplayUnits
from bayesdrill.inference.residual_checks import like_noise
from bayesdrill.report import section
from bayesdrill.report.doubts import unbelievable
from bayesdrill.report.scales import DOUBLE
from bayesdrill.report.section import (
    Badge,
    Badges,
    Note,
    Picture,
    Section,
    Table,
    build,
    listed,
    table_of,
)
from bayesdrill.report.sections.causes import instead, lacking
from bayesdrill.report.sections.corner import corner_figure
from bayesdrill.report.sections.identifiability import percent, priors_of, product
from bayesdrill.report.sections.parameters import believed_columns
from bayesdrill.report.style import Figure
from bayesdrill.report.view import Drawing, ReportContext, ReportPart

REPEATS_EXPLAINED = (
    "Each experiment alone, around the joint maximum: the deviation of its estimate of a product "
    "from the joint one, and its standard deviation. `spread` is the variation between experiments "
    "that these standard deviations do not explain."
)


def repeats_sentence(repeats: Sequence[RepeatedProduct], names: Sequence[str]) -> str:
    """Describe whether the experiments agree; empty if no product could be compared."""
    if not repeats:
        return ""
    differing = [repeat for repeat in repeats if repeat.differs]
    if not differing:
        return (
            "experiments: within their uncertainty, all of them show the same rig "
            f"({count_noun(len(repeats), 'product')} compared)."
        )
    each = ", ".join(
        f"{product(names, repeat.exponents)} by {percent(repeat.spread)} (sds of "
        f"{percent(min(repeat.sds))} to {percent(max(repeat.sds))})"
        for repeat in sorted(differing, key=lambda repeat: repeat.p)
    )
    return (
        f"experiments: they do not show the same rig: {each}. The sds of the joint posterior are too "
        "small. The rig changed, or the model lacks an effect. `own: [...]` lets a parameter differ."
    )


def repeats_table(repeats: Sequence[RepeatedProduct], names: Sequence[str]) -> Table:
    """Build a table with a line for each product."""
    labels = dict.fromkeys((label for repeat in repeats for label in repeat.labels), "")

    def cells(repeat: RepeatedProduct) -> dict[str, str]:
        each = zip(repeat.labels, repeat.apart, repeat.sds, strict=True)
        return {
            "": product(names, repeat.exponents),
            **(labels | {name: f"{100 * x:+.2g} % +- {percent(sd)}" for name, x, sd in each}),
            "spread": percent(repeat.spread) if repeat.spread else "none",
            "by chance": "**no**" if repeat.differs else f"{repeat.p:.2g}",
        }

    return table_of(map(cells, repeats), "")


SHORT = ("", "nominal", "mean", "dev. %", "tension", "beyond tol.", "bits", "verdict")
VERDICT_EXPLAINED = (
    "All in SI. First come products of powers, which the record can show, then the parameters by "
    "themselves. `dev. %` is the deviation of the posterior mean from the nominal value. `tension` "
    "is the distance of the nominal value from the posterior, in sigma. With a tolerance `tol. %`, "
    "it is that of the nearest value within the tolerance. `beyond tol.` is the probability that the "
    "deviation exceeds the tolerance. `sd/prior` is the standard deviation of the log divided by "
    "that of the prior. `bits` is the information gained on the prior: one bit halves a range."
)


def verdict_rule(verdict: Verdict) -> str:
    """Define the terms of the verdict."""
    return (
        f"*disagrees*: more than {verdict.limit:.2f} sigma. If the table were right within its "
        f"tolerances, at most {100 * FALSE_ALARM:g} % of records would show a disagreement of any "
        "quantity. *In doubt*: just as far, but the fit leaves more than noise, so the model may "
        "be wrong and not the table. *Not determined*: the posterior is mostly the prior, so the "
        "record says nothing for or against the nominal value."
    )


def verdict_rows(verdict: Verdict) -> tuple[Quantity, ...]:
    """Return the rows: products, then parameters that are not among them."""
    shown = {quantity.exponents for quantity in verdict.products}
    return (*verdict.products, *(q for q in verdict.parameters if q.exponents not in shown))


def verdict_table(verdict: Verdict) -> Table:
    """Return the table of the verdict; columns of tolerances are left out if they are empty."""

    def cells(quantity: Quantity) -> dict[str, str]:
        low, high = (100 * end for end in quantity.tolerance)
        return {
            "": quantity_name(verdict, quantity),
            "nominal": f"{quantity.nominal:.4g}",
            "tol. %": f"{low:+.3g} to {high:+.3g}" if high > low else "",
            "mean": f"{quantity.mean:.4g}",
            "sd": f"{quantity.sd:.2g}",
            section.HDI: f"{quantity.hdi_low:.4g} to {quantity.hdi_high:.4g}",
            "dev. %": f"{100 * quantity.deviation:+.3g}",
            "tension": sigmas(quantity.tension).removesuffix(" sigma"),
            "beyond tol.": "" if quantity.beyond is None else f"{100 * quantity.beyond:.1f} %",
            "sd/prior": f"{quantity.sd_ratio:.2g}",
            "bits": f"{quantity.bits:.1f}",
            "verdict": quantity.says,
        }

    table = table_of(map(cells, verdict_rows(verdict)), "", "verdict", brief=SHORT)
    return table.filled("tol. %", "beyond tol.")


def verdict_csv(verdict: Verdict, symbols: Sequence[Symbol]) -> str:
    """Return the verdict as CSV: full precision, SI units of `symbols`, shares as fractions."""
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


def sigmas(x: float) -> str:
    """Return a deviation in sigma, as a text."""
    return f"{round(x, 1) + 0.0:.1f} sigma" if x < 10 else f"{x:.0f} sigma"  # never -0.0


def quantity_name(verdict: Verdict, quantity: Quantity) -> str:
    """Return the name of a product, such as `k_s/j_1`."""
    return product(verdict.names, quantity.exponents)


def invariants_figure(
    verdict: Verdict, draws: Array, mode: Array, symbols: Sequence[Symbol], width: float = DOUBLE
) -> Figure:
    """Draw products that are determined, or else all; `draws (N, D)` and the MAP are in SI."""
    sure = [q for q in verdict.products if q.says != "not determined"]
    selected = sure or list(verdict.products)
    deviations = tuple(
        Symbol(
            name=product(verdict.names, quantity.exponents),
            unit="%",
            latex=rf"\Delta\,{product_latex(quantity.exponents, symbols)}",
            latex_unit=r"\%\;of\;nominal",
            meaning="deviation from the nominal value",
        )
        for quantity in selected
    )
    names = [symbol.name for symbol in deviations]
    powers = np.array([quantity.exponents for quantity in selected], dtype=float)
    table = np.log([quantity.nominal for quantity in selected])
    m = len(verdict.names)
    off = 100 * np.expm1(np.log(draws[:, :m]) @ powers.T - table)
    at = 100 * np.expm1(np.log(mode[:m]) @ powers.T - table)
    shown = DisplayedUnknowns(
        symbols=deviations,
        nominal=dict.fromkeys(names, 0.0),
        mode=dict(zip(names, at.tolist(), strict=True)),
    )
    return corner_figure(off, shown, width)


def _draw_invariants(run: ReportContext) -> Drawing | None:
    if run.analysis.judged is None or not run.analysis.judged.verdict.products:
        return None
    at = (run.draws, run.chain.best, run.problem.symbols, run.width)
    says = "The products of parameters that such a record can show (corner plot)."
    return Drawing(invariants_figure, (run.analysis.judged.verdict, *at), says)


def _sections(run: ReportContext, pictures: Sequence[Picture]) -> Iterator[Section]:
    judged, repeats = run.analysis.judged, run.analysis.repeats
    if judged is None:
        return
    rule = None if run.reasons else Note(verdict_rule(judged.verdict))
    shown = believed_columns(run, verdict_table(judged.verdict))
    yield build("Against the nominal table", shown, rule, Note(VERDICT_EXPLAINED), *pictures)
    if repeats:
        given = (repeats, judged.study.names)
        each = (repeats_sentence(*given), repeats_table(*given), Note(REPEATS_EXPLAINED))
        yield build("From one experiment to the next", *each)


def _verdict_file(run: ReportContext) -> str | None:
    judged = run.analysis.judged
    return None if judged is None else verdict_csv(judged.verdict, run.problem.symbols)


def run_marks(run: ReportContext) -> tuple[Badge, ...]:
    """Build the badges of a run; none is green if the run must not be believed."""
    converged = run.sampled.convergence.converged
    first = Badge("converged", "good") if converged else Badge("not converged", "bad")
    fit = Badge("more than noise is left", "doubt")
    if any(summary.unbelievable for summary in run.analysis.fit):
        fit = Badge("does not fit", "bad")
    elif like_noise(run.analysis.fit):
        fit = Badge("fits: the rest looks like noise", "good")
    if run.reasons:
        plain = [
            replace(summary, tone="plain") if summary.tone == "good" else summary
            for summary in (fit, first)
        ]
        return tuple(sorted(plain, key=lambda badge: badge.tone != "bad"))
    if run.analysis.judged is None:
        return first, fit
    return first, fit, _table_mark(run.analysis.judged.verdict, run.problem.compared_with)


def _table_mark(verdict: Verdict, table: str) -> Badge:
    if not verdict.judged:
        return Badge(f"says nothing of {table}", "doubt")
    if not verdict.fits:
        return Badge("verdict in doubt", "doubt")
    if verdict.agrees:
        return Badge(f"agrees with {table}", "good")
    return Badge(f"disagrees with {table}", "doubt")


def run_verdict(run: ReportContext) -> str:
    """Describe the verdict in a line, then its conditions; empty if nothing is compared."""
    judged, rig = run.analysis.judged, run.problem.model
    if judged is None:
        return ""
    converged = run.sampled.convergence.converged
    said = verdict_sentences(
        judged.verdict,
        run.problem.compared_with,
        converged=converged,
        believed=not run.reasons,
        records=len(run.problem.observations),
        lacking=lacking(run.analysis.causes, rig.roles),
        rests=judged.study.resting,
        units=run.units,
    )
    more = instead(run.analysis.instead, rig) if converged else ()
    return "\n".join([said, *more])


_HOLDS = (
    "which the config holds fixed. An error of the latter becomes an error of the former, and the fit "
    "is as good. With a prior instead, a run shows what the record alone determines"
)
_LEANS = "as the record alone determines little more than ratios"


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
    """Return the verdict in a sentence, then its conditions and the undecided quantities.

    `believed` is false if the run must not be believed, `records` is the number of experiments, and
    `lacking` names what the model may miss.
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
    """Describe the verdict of a run that must not be believed."""
    because = "the model does not fit" if converged else "the run did not converge"
    return f"verdict: none, because {because}. The numbers may be wrong."


def verdict_sentence(verdict: Verdict, table: str, records: int = 1) -> str:
    """Return the verdict: how many products are determined, and whether each and all agree."""
    n, k = len(verdict.products), len(verdict.judged)
    determines, such, says = "this record determines", "such a record", "It says"
    if records > 1:
        determines, such, says = "these records determine", "such records", "They say"
    can = f"the {count_noun(n, 'independent product')} of parameters that {such} can show"
    if not verdict.judged:
        none = f"{determines} none of {can}"
        if verdict.saying("cannot judge"):
            none = f"none of {can} can be judged"
        return f"verdict: {none}. {says} nothing of {table}."
    joint = together = ""
    if verdict.joint is not None:
        joint = f"taken together they are {sigmas(verdict.joint)} away"
        together = f" {joint[0].upper()}{joint[1:]}."
    opening = f"verdict: {determines} {k} of {can}."
    if n == 1:
        opening = f"verdict: {determines} the one quantity that is compared."
    if verdict.far:
        listed = ", ".join(
            f"{quantity_name(verdict, q)} ({100 * q.deviation:+.3g} %, {sigmas(q.tension)})"
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
    """Describe which judgements hold only if a fixed value or a prior is right."""
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
    ends = [f"of {name} ends at {units.format_value(name, e)}" for name, e in verdict.ends.items()]
    reasons = {
        "Not determined by themselves": (
            [q for q in verdict.saying("not determined") if q.blind],
            "No record of these channels can tell them apart: some of them can be multiplied by one "
            "factor, and no measured signal changes. Only their products count.",
        ),
        "Not determined": (
            verdict.undetermined,
            "This record says almost nothing about them: their values are mostly those of the prior. A "
            "longer or cleaner record could show them.",
        ),
        "At an end of its prior": (
            verdict.saying("pressed against the prior"),
            "The end of the prior decides, so nothing is said about the nominal value.",
        ),
        "Cannot judge": (
            verdict.saying("cannot judge"),
            f"The prior {', that '.join(ends)}; widen it. Hardly any draw can pass the nominal value, "
            "whatever the record shows.",
        ),
    }
    for said, (quantities, why) in reasons.items():
        if quantities:
            yield f"{said}: {', '.join(quantity_name(verdict, q) for q in quantities)}. {why}"


def _verdict(run: ReportContext, _: Sequence[Picture]) -> Iterator[Section]:
    doubts = unbelievable(run.reasons, converged=run.sampled.convergence.converged)
    yield build("Verdict", Badges(run_marks(run)), doubts, run_verdict(run))


VERDICT = ReportPart(sections=_verdict)
PART = ReportPart(
    sections=_sections,
    figures={"invariants": _draw_invariants},
    files={"verdict.csv": _verdict_file},
)
