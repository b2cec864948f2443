"""The verdict: what the posterior says of the nominal table, and where it can say nothing.

All in logs of the unknowns.  Quantities are the parameters, and independent products of their
powers that no exact symmetry changes: as many as the record can show at all.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from bayesdrill.basics import seeds
from bayesdrill.basics.checked import checked
from bayesdrill.engines.sampling import Opened
from bayesdrill.inference.problem import Problem
from bayesdrill.insight import plausibility
from bayesdrill.insight.diagnostics import Row, hdi
from bayesdrill.insight.identifiability.information import Information, products, simple_exponents
from bayesdrill.insight.identifiability.scenes import Scenery
from bayesdrill.insight.identifiability.structure import Exponents
from bayesdrill.insight.identifiability.study import Asked, Study, Thresholds, study_of
from bayesdrill.insight.tension import bits_gained, joint_tension, tension

Array = NDArray[np.float64]
Says = Literal["agrees", "disagrees", "in doubt", "not determined", "pressed against the prior"]

FALSE_ALARM = 0.01  # of records of a rig that is nominal: any "disagrees" at all
BORROWED = 0.25  # sd over the prior's: below, something much better known stands behind a symmetry
PRIOR_DRAWS = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A product of powers of the unknowns, SI; `deviation` of the mean, relative to `nominal`.

    `tolerance`: relative ends.  `tension`: sigmas between posterior and the nearest value within
    tolerance.  `beyond`: probability of a deviation past the tolerance, None without one.
    `sd_ratio`: sd of the log over the prior's.  `bits`: information gained on the prior.  `blind`: an
    exact symmetry changes it, so that no record of these channels can show it.
    """

    exponents: Exponents
    nominal: float
    tolerance: tuple[float, float]
    mean: float
    sd: float
    hdi_low: float
    hdi_high: float
    deviation: float
    tension: float
    beyond: float | None
    sd_ratio: float
    bits: float
    blind: bool
    says: Says


@checked
@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """`limit`: sigmas from which a quantity disagrees.  `joint`: sigmas between posterior and table
    over the determined products together, None if there are not two.  `fits`: the fit leaves nothing
    but noise; where it does not, what would disagree is *in doubt*: it counts on the model, against
    which the fit is evidence.  `opened`: unknowns whose priors end so near to their nominal values
    that tensions are counted with these ends opened.
    """

    names: tuple[str, ...]
    parameters: tuple[Quantity, ...]
    products: tuple[Quantity, ...]
    limit: float
    joint: float | None
    fits: bool = True
    opened: tuple[str, ...] = ()

    def saying(self, says: Says) -> tuple[Quantity, ...]:
        """Parameters and products, each once."""
        every = {quantity.exponents: quantity for quantity in (*self.products, *self.parameters)}
        return tuple(quantity for quantity in every.values() if quantity.says == says)

    @property
    def far(self) -> tuple[Quantity, ...]:
        """What is farther from the table than chance, whoever is to blame."""
        return (*self.saying("disagrees"), *self.saying("in doubt"))

    @property
    def far_together(self) -> bool:
        return self.joint is not None and self.joint > self.limit

    @property
    def agrees(self) -> bool:
        return not self.far_together and not self.far


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """`findings`: sentences of `physics` on the posterior."""

    study: Study
    verdict: Verdict
    findings: tuple[str, ...]


def judgement(
    problem: Problem,
    asked: Asked,
    scenery: Scenery,
    mode: Array,
    draws: Array,
    rows: Sequence[Row],
    beyond: Opened | None,
    *,
    fits: bool,
) -> Judgement | None:
    """From the MAP `(D,)` and draws `(N, D)`; None where no unknown has a nominal value.

    `beyond`: what is seen where priors end too near to nominal values; `fits`: see `Verdict`.
    """
    posterior = problem.posterior
    if not any(name in problem.nominal for name in scenery.unknowns):
        return None
    found = study_of(scenery, posterior, mode, asked, "the MAP")
    space, m = posterior.space, len(found.names)
    prior_draws = space.draw(PRIOR_DRAWS, seeds.stream(asked.seed, "identify", 1))
    prior_draws = prior_draws[np.isfinite(space.log_prior(prior_draws))]
    verdict = judge(
        found,
        draws[:, :m],
        prior_draws[:, :m],
        problem.nominal,
        problem.tolerance,
        [row.name for row in rows if row.pressed_against is not None],
        asked.thresholds,
        beyond,
        fits=fits,
    )
    findings = (
        *plausibility.of_draws(problem, draws, found.information),
        *plausibility.of_course(scenery, mode),
    )
    return Judgement(study=found, verdict=verdict, findings=findings)


def judge(
    study: Study,
    draws: Array,
    prior_draws: Array,
    nominal: Mapping[str, float],
    tolerance: Mapping[str, float],
    pressed: Collection[str],
    thresholds: Thresholds,
    beyond: Opened | None = None,
    *,
    fits: bool = True,
) -> Verdict:
    """From nearly independent physical draws `(N, m)` of `study.names`, and of their prior.

    Quantities with an unknown that has no nominal value are left out; `pressed` names unknowns whose
    draws crowd at an end of their prior.  Tensions are counted in the draws of `beyond`.
    """
    m, free = len(study.names), beyond is None or beyond.draws is not None
    names = () if beyond is None else beyond.names
    crowd = {*pressed} if beyond is None else {*pressed} - {*names} | {*beyond.pressed}
    seen = draws if beyond is None or beyond.draws is None else beyond.draws[:, :m]
    table = np.array([math.log(nominal.get(name, math.nan)) for name in study.names])
    scene = _Scene(
        study=study,
        known=study.information,
        logs=np.log(draws) - table,
        seen=np.log(seen) - table,
        prior_logs=np.log(prior_draws) - table,
        table=table,
        ends=np.array([_ends(tolerance.get(name, 0.0)) for name in study.names]),
        pressed=np.array([name in crowd for name in study.names]),
        unseen=np.array([not free and name in names for name in study.names]),
        thresholds=thresholds,
        fits=fits,
    )
    units = [tuple(int(x) for x in row) for row in np.eye(m, dtype=int)[np.isfinite(table)]]
    chosen = basis(study, nominal)
    looked_at = dict.fromkeys((*units, *chosen))
    shown = {e: scene.shows(e) for e in looked_at}
    limit = sigma_limit(1 + sum(shown.values()))
    found = {e: scene.quantity(e, shown=shown[e], limit=limit) for e in looked_at}
    return Verdict(
        names=study.names,
        parameters=tuple(found[e] for e in units),
        products=tuple(found[e] for e in chosen),
        limit=limit,
        joint=scene.joint([e for e in chosen if shown[e] and not scene.hides(e)]),
        fits=fits,
        opened=names if free else (),
    )


def basis(study: Study, among: Collection[str]) -> tuple[Exponents, ...]:
    """Independent products of unknowns `among` these alone that no symmetry changes: all there are.

    First those that the record narrows, the most narrowed first, then the sparsest: where others take
    part in what is narrowed most of all, the rest would not span what it tells of these.
    """
    simple = simple_exponents(len(study.names))
    foreign = [name not in among for name in study.names]
    simple = simple[~simple[:, foreign].any(axis=1)]
    simple = simple[np.isfinite(study.information.bounds_of(simple))]
    before = np.array([parameter.prior_sd for parameter in study.parameters])
    best = products(study.information, before, simple)
    chosen = [product.exponents for product in best if product.price < 1.0]
    for exponents in study.structure.invariants_of(among):
        if np.linalg.matrix_rank(np.array([*chosen, exponents], dtype=float)) > len(chosen):
            chosen.append(exponents)
    return tuple(chosen)


def sigma_limit(n: int) -> float:
    """So that `n` looks together pass it by chance with probability `FALSE_ALARM` at most."""
    return float(norm.isf(0.5 * FALSE_ALARM / n))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Scene:
    """`logs`, `prior_logs`: of the draws over the nominal values; `ends (m, 2)` of the tolerance.

    `seen`: as `logs`, but beyond ends that are in the way; of those `unseen` it shows nothing.
    """

    study: Study
    known: Information
    logs: Array
    seen: Array
    prior_logs: Array
    table: Array
    ends: Array
    pressed: NDArray[np.bool_]
    unseen: NDArray[np.bool_]
    thresholds: Thresholds
    fits: bool

    def shows(self, exponents: Exponents) -> bool:
        """Whether record and priors determine it: not its own prior, not the corners of the priors."""
        powers = np.array(exponents, dtype=float)
        before = np.array([parameter.prior_sd for parameter in self.study.parameters])
        linear = self.known.with_priors(before).bound(powers) / np.linalg.norm(before * powers)
        drawn = self._sd_ratio(exponents)
        if self._blind(exponents):
            return bool(max(linear, drawn) < BORROWED)
        if self.thresholds.judge(linear) == "left to the prior":
            return False
        return self.thresholds.judge(drawn) == "determined"

    def quantity(self, exponents: Exponents, *, shown: bool, limit: float) -> Quantity:
        logs = _combined(self.logs, exponents)
        nominal = math.exp(_combined(self.table, exponents))
        low, high = self._tolerance(exponents)
        far = tension(_combined(self.seen, exponents), low, high)
        x = nominal * np.exp(logs)
        near, distant = hdi(x)
        mean = float(x.mean())
        alone = np.count_nonzero(exponents) == 1
        crowded = alone and bool(self.pressed[np.flatnonzero(exponents)[0]])
        crowded |= self.hides(exponents)
        return Quantity(
            exponents=exponents,
            nominal=nominal,
            tolerance=(math.expm1(low), math.expm1(high)),
            mean=mean,
            sd=float(x.std(ddof=1)),
            hdi_low=near,
            hdi_high=distant,
            deviation=mean / nominal - 1.0,
            tension=far,
            beyond=float(np.mean((logs < low) | (logs > high))) if high > low else None,
            sd_ratio=self._sd_ratio(exponents),
            bits=bits_gained(logs, _combined(self.prior_logs, exponents)),
            blind=self._blind(exponents),
            says=_says(crowded=crowded, shown=shown, far=far > limit, fits=self.fits),
        )

    def joint(self, products: list[Exponents]) -> float | None:
        if len(products) < 2:
            return None
        powers = np.array(products, dtype=float)
        used = np.any(powers != 0, axis=0)
        ends = np.where(used[:, None], self.ends, 0.0)
        logs = np.where(used, self.seen, 0.0) @ powers.T
        return joint_tension(logs, powers, ends)

    def hides(self, exponents: Exponents) -> bool:
        """Whether an end of a prior is in the way that could not be opened."""
        return bool(self.unseen[np.flatnonzero(exponents)].any())

    def _blind(self, exponents: Exponents) -> bool:
        return not math.isfinite(self.known.bound(np.array(exponents, dtype=float)))

    def _sd_ratio(self, exponents: Exponents) -> float:
        before = _combined(self.prior_logs, exponents)
        return float(_combined(self.logs, exponents).std() / before.std())

    def _tolerance(self, exponents: Exponents) -> tuple[float, float]:
        """Ends of the log: every factor at the end of its own tolerance."""
        powers = np.array(exponents)[:, None] * self.ends
        return float(powers.min(axis=1).sum()), float(powers.max(axis=1).sum())


def _says(*, crowded: bool, shown: bool, far: bool, fits: bool) -> Says:
    if crowded:
        return "pressed against the prior"
    if not shown:
        return "not determined"
    if not far:
        return "agrees"
    return "disagrees" if fits else "in doubt"


def _ends(tolerance: float) -> tuple[float, float]:
    return math.log1p(-tolerance), math.log1p(tolerance)


def _combined(logs: Array, exponents: Exponents) -> Array:
    """Only of the factors: the others may have no nominal value."""
    used = np.flatnonzero(exponents)
    return np.asarray(logs[..., used] @ np.array(exponents, dtype=float)[used])
