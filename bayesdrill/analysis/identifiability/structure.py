"""Find exact scaling symmetries of a posterior, and unknowns that depend on fixed numbers.

A symmetry multiplies unknowns by powers of any factor without changing a measured signal.  The null
space of the log-sensitivities at several points of the prior gives candidates with small whole
exponents.  Each candidate is proven by scaling by two: the response is the same to rounding.

Unknowns may have a common scale that only a fixed number determines, not the signals.  With another
value of the number, these unknowns would differ, and the record would look the same.  If the record
hardly determines these unknowns, priors determine the scale instead.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from bayesdrill.analysis.identifiability.information import (
    RANK_TOLERANCE,
    Information,
    SensitivityStudy,
    root_of,
)
from bayesdrill.basics.arrays import Array, StoredArray
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import Unknown

Exponents = tuple[int, ...]

SAME_RESPONSE = 1e-9  # tolerance of equal responses, relative to the largest value of each channel
SAME_DIRECTION = 1e-6  # singular value divided by the largest, below which directions are dependent
MAX_DENOMINATOR = 6  # largest denominator in the search for whole exponents
MAX_BASES = 5000  # largest number of pivot sets that are tried


@dataclass(frozen=True, slots=True, kw_only=True)
class ScalingStructure:
    """A posterior has scaling symmetries, and products that they do not change.

    `symmetries` are proven exponents of the unknowns, the sparsest first. `invariants` are exponents of
    independent products that no symmetry changes. `unexplained` counts other directions that change no
    signal: they have no small whole exponents, or vary over the prior.
    """

    names: tuple[str, ...]
    symmetries: tuple[Exponents, ...]
    invariants: tuple[Exponents, ...]
    unexplained: int

    def invariants_of(self, names: Collection[str]) -> tuple[Exponents, ...]:
        """Return independent invariant products of these unknowns alone, the sparsest first."""
        columns = [k for k, name in enumerate(self.names) if name in names]
        m = len(self.names)
        changed = _complement(np.array(self.invariants, dtype=float).reshape(-1, m), m)[:, columns]
        basis = sparse_basis(_complement(changed, len(columns)))
        factors = [dict(zip(columns, exponents, strict=True)) for exponents in basis]
        return tuple(tuple(powers.get(k, 0) for k in range(m)) for powers in factors)


def null_space(sensitivities: Sequence[Array], *, nearly: bool = False) -> Array:
    """Return directions `(n, m)` of log unknowns that change no signal at any of the points.

    Points without motion, such as those at which a rig sticks, are ignored.  `nearly` includes
    directions with tiny effects, which may be due to rounding, so that each has to be proven.
    """
    moving = [s / size for s in sensitivities if (size := np.linalg.norm(s)) > 0]
    if not moving:
        return np.eye(sensitivities[0].shape[1])
    _, values, rows = np.linalg.svd(np.concatenate(moving))
    is_null = values <= RANK_TOLERANCE * values[0]
    if nearly:
        before = np.concatenate([values[:1], values[:-1]])
        # Rounding errors of a stiff rig are larger, but far below all other singular values.
        is_null |= (values < NULL_BELOW * values[0]) & (values < NULL_GAP * before)
    rank = int(np.argmax(is_null)) if is_null.any() else len(values)
    return np.asarray(rows[rank:])


def find_structure(
    names: tuple[str, ...], sensitivities: Sequence[Array], unchanged: Callable[[Exponents], bool]
) -> ScalingStructure:
    """Find symmetries in sensitivities `(T K, m)` at several points; `unchanged` proves each."""
    sensitivities = [root_of(s) for s in sensitivities]
    null = null_space(sensitivities)
    candidates = sparse_basis(null_space(sensitivities, nearly=True))
    proven = tuple(exponents for exponents in candidates if unchanged(exponents))
    local = [null_space([point]) for point in sensitivities if point.any()]
    blind = max(min(map(len, local), default=len(null)), len(proven))
    if blind > len(null):  # the null directions depend on the point, as those of a sum a + b do
        hidden = np.concatenate(local)
    elif len(proven) >= len(null):
        hidden = np.array(proven, dtype=float).reshape(-1, len(names))
    else:
        hidden = null
    return ScalingStructure(
        names=names,
        symmetries=proven,
        invariants=sparse_basis(_complement(hidden, len(names))),
        unexplained=blind - len(proven),
    )


def sparse_basis(rows: Array) -> tuple[Exponents, ...]:
    """Return the sparsest independent whole-number vectors, at most n, in the span of `rows (n, m)`."""
    n, m = rows.shape
    candidates: set[Exponents] = set()
    for pivots in itertools.islice(itertools.combinations(range(m), n), MAX_BASES):
        block = rows[:, pivots]
        if n == 0 or np.linalg.cond(block) > 1e8:
            continue
        candidates |= {e for e in map(_as_integers, np.linalg.solve(block, rows)) if e is not None}
    independent: list[Exponents] = []
    for candidate in sorted(candidates, key=_complexity):
        extended = np.array([*independent, candidate], dtype=float)
        if np.linalg.matrix_rank(extended) > len(independent):
            independent.append(candidate)
    return tuple(independent)


def scaled_by_two(theta: Array, exponents: Exponents) -> Array:
    """Return `theta (..., D)` with unknown k times `2.0 ** exponents[k]`, which is exact in floats."""
    powers = np.zeros(theta.shape[-1])
    powers[: len(exponents)] = exponents
    return np.asarray(theta * 2.0**powers)


def _complement(rows: Array, m: int) -> Array:
    if len(rows) == 0:
        return np.eye(m)
    _, values, directions = np.linalg.svd(rows)
    return np.asarray(directions[int(np.sum(values > SAME_DIRECTION * values[0])) :])


def _as_integers(row: Array) -> Exponents | None:
    """Return the row times the smallest factor that makes all entries whole, or None."""
    fractions = [Fraction(float(x)).limit_denominator(MAX_DENOMINATOR) for x in row]
    if any(abs(float(f) - x) > 1e-6 for f, x in zip(fractions, row, strict=True)):
        return None
    factor = math.lcm(*(f.denominator for f in fractions))
    whole = [int(f * factor) for f in fractions]
    divisor = math.gcd(*whole)
    if divisor == 0:
        return None
    sign = 1 if sum(whole) > 0 or (sum(whole) == 0 and next(x for x in whole if x) > 0) else -1
    return tuple(sign * x // divisor for x in whole)


def _complexity(exponents: Exponents) -> tuple[int, int, Exponents]:
    used = sum(x != 0 for x in exponents)
    return used, sum(abs(x) for x in exponents), tuple(-x for x in exponents)


NULL_BELOW, NULL_GAP = 1e-7, 1e-4  # limits of a null singular value / largest, and / next larger
PRIOR_POINTS = 4  # number of points, in addition to the given one, where symmetries must hold
# These points are at this fraction of the distance from the given point to draws from the prior.  At
# the ends of wide priors, rigs are so stiff that rounding hides symmetries.
PRIOR_SHARE = 0.25
MAX_DRAWS = 100  # number of prior draws from which these points are taken; some responses overflow


def structure_of(
    posterior: Posterior, sensitivity: SensitivityStudy, theta: Array, rng: np.random.Generator
) -> ScalingStructure:
    """Find the scaling symmetries at `theta (D,)` and at points towards draws from the prior."""
    to, back = posterior.coordinates.from_physical, posterior.coordinates.to_physical
    start = to(theta[None])
    drawn = back(start + PRIOR_SHARE * (to(posterior.space.draw(MAX_DRAWS, rng)) - start))
    finite = drawn[np.isfinite(posterior.density(drawn))][:PRIOR_POINTS]
    points = np.vstack([theta, finite])
    likelihood = posterior.likelihood
    signals = likelihood.all_signals(points)

    def unchanged(exponents: Exponents) -> bool:
        scaled = likelihood.all_signals(scaled_by_two(points, exponents))
        return all(
            np.all(np.abs(x - y) <= SAME_RESPONSE * np.abs(x).max(axis=(0, 1)))
            for x, y in zip(signals, scaled, strict=True)
        )

    sensitivities = [sensitivity.sensitivities(point) for point in points]
    return find_structure(sensitivity.unknowns, sensitivities, unchanged)


FREED_RANGE = 0.5, 1.5  # range over which a fixed number is varied, relative to its value
MIN_PRIOR_SHARE = 0.5  # least effect: of all priors / total effect, of a named prior / largest one


@dataclass(frozen=True, slots=True, kw_only=True)
class DependsOnFixed:
    """The fixed numbers `held`, which are last in `names`, determine a scale of unknowns.

    No signal changes if each of `names` is multiplied by a factor to the power in `exponents`.
    `following (m, m)` are derivatives (d posterior mean / d prior mean) of logs.
    """

    names: tuple[str, ...]
    exponents: Exponents
    held: tuple[str, ...]
    following: StoredArray

    @property
    def _powers(self) -> dict[str, int]:
        return dict(zip(self.names, self.exponents, strict=True))

    @property
    def unknown(self) -> tuple[str, ...]:
        """Return the unknowns whose scale the fixed numbers determine."""
        return tuple(name for name, e in self._powers.items() if e and name not in self.held)

    @property
    def through(self) -> tuple[str, ...]:
        """Return the fixed numbers that determine the scale."""
        return tuple(name for name, e in self._powers.items() if e and name in self.held)

    @property
    def narrowest(self) -> str:
        """Return the unknown that the record narrows most."""
        following = dict(zip(self.names, np.diag(self.following), strict=False))
        return min(self.unknown, key=following.__getitem__)

    def scales(self, names: Sequence[str], exponents: Sequence[float]) -> bool:
        """Return whether a product of powers changes with the fixed numbers."""
        pairs = zip(names, exponents, strict=True)
        return sum(self._powers[name] * e for name, e in pairs) != 0

    def priors(self, names: Sequence[str], exponents: Sequence[float]) -> tuple[str, ...]:
        """Return unknowns whose priors determine a product of powers for which `scales` is true.

        The result is empty if the product follows the fixed numbers more than the priors.
        """
        m = len(self.following)
        given = dict(zip(names, exponents, strict=True))
        powers = np.array([given.get(name, 0.0) for name in self.names[:m]])
        scale, follows = np.array(self.exponents[:m]), powers @ self.following
        if follows @ scale / (powers @ scale) < MIN_PRIOR_SHARE:
            return ()
        large = np.abs(follows) >= MIN_PRIOR_SHARE * np.abs(follows).max()
        return tuple(name for name, is_large in zip(self.names, large, strict=False) if is_large)


def depends_on_fixed(
    posterior: Posterior,
    theta: Array,
    information: Information,
    prior_sd: Array,
    rng: np.random.Generator,
) -> tuple[DependsOnFixed, ...]:
    """Find the scales of unknowns that fixed numbers determine.

    Users expect scales with more fixed numbers than unknowns, so these are omitted.  `information`
    holds at `theta (D,)`, `prior_sd (m,)` are sds of logs, and `rng` draws points of the prior.
    """
    space, observations = posterior.space, posterior.likelihood.observations
    model = observations[0].response.model
    called = {x: n for each in observations for n, x in each.named(model.parameters).items()}
    fixed = tuple(name for name in called if space.fixed.get(name, 0.0) > 0.0)
    if not fixed:
        return ()
    values = [space.fixed[name] for name in fixed]
    low, high = FREED_RANGE
    freed = []
    for name, value in zip(fixed, values, strict=True):
        symbol = dataclasses.replace(model.symbols[called[name]], name=name)
        prior = Uniform(low=low * value, high=high * value)
        freed.append(Unknown(symbol=symbol, role="rig", prior=prior, start=value))
    wider = posterior.edit(free=freed)
    point = np.insert(theta, len(space.columns("rig", "quantity")), values)
    structure = structure_of(wider, SensitivityStudy(wider.likelihood), point, rng)
    follows = prior_following(information, prior_sd)
    scales = (
        DependsOnFixed(names=structure.names, exponents=e, held=fixed, following=follows)
        for e in structure.symmetries
    )
    return tuple(scale for scale in scales if 0 < len(scale.through) <= len(scale.unknown))


def prior_following(information: Information, prior_sd: Array) -> Array:
    """Return derivatives `(m, m)` of the posterior mean of each log by the mean of each prior."""
    spread = np.linalg.inv(information.with_priors(prior_sd).root)
    return np.asarray(spread @ spread.T / prior_sd**2)
