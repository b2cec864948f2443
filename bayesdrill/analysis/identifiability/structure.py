"""Find exact scaling symmetries of a posterior, and unknowns that depend on fixed numbers.

Symmetries are products of powers of the unknowns that no measured signal shows.  They are found in
the null space of the log-sensitivities at several points of the prior, written with small whole
exponents, and each one proven by scaling: twice the factor, the same response to rounding.

A number that is held settles a scale that no signal shows: were it another, so would be all that is
told through it, and the record would look the same.  Unless the record hardly shows that number:
then priors settle the scale, held or not.
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

SAME_RESPONSE = 1e-9  # relative to the largest value of each channel
SAME_DIRECTION = 1e-6  # null directions of different points are equal to this
MAX_DENOMINATOR = 6
MAX_BASES = 5000


@dataclass(frozen=True, slots=True, kw_only=True)
class ScalingStructure:
    """The scaling symmetries of a posterior.

    `symmetries`: proven exponents of the unknowns, sparsest first. `invariants`: independent
    products that nothing of this changes. `unexplained`: further directions that no signal shows,
    but that are no product of powers with small whole exponents, or not the same one everywhere.
    """

    names: tuple[str, ...]
    symmetries: tuple[Exponents, ...]
    invariants: tuple[Exponents, ...]
    unexplained: int

    def invariants_of(self, names: Collection[str]) -> tuple[Exponents, ...]:
        """Return independent products of these unknowns alone that are invariant, sparsest first."""
        columns = [k for k, name in enumerate(self.names) if name in names]
        m = len(self.names)
        changed = _complement(np.array(self.invariants, dtype=float).reshape(-1, m), m)[:, columns]
        basis = sparse_basis(_complement(changed, len(columns)))
        factors = [dict(zip(columns, exponents, strict=True)) for exponents in basis]
        return tuple(tuple(powers.get(k, 0) for k in range(m)) for powers in factors)


def null_space(sensitivities: Sequence[Array], *, nearly: bool = False) -> Array:
    """Return directions of log unknowns that change nothing at any of the points: `(n, m)` rows.

    Points at which nothing moves, as of a rig that sticks from the start, say nothing.  `nearly`: also
    those that change next to nothing, which may be hardly seen or rounding, and are to be proven.
    """
    moving = [s / size for s in sensitivities if (size := np.linalg.norm(s)) > 0]
    if not moving:
        return np.eye(sensitivities[0].shape[1])
    _, values, rows = np.linalg.svd(np.concatenate(moving))
    nothing = values <= RANK_TOLERANCE * values[0]
    if nearly:
        before = np.concatenate([values[:1], values[:-1]])
        # Of a stiff rig rounding leaves more of what is nothing; but then it is far below all else.
        nothing |= (values < NULL_BELOW * values[0]) & (values < NULL_GAP * before)
    rank = int(np.argmax(nothing)) if nothing.any() else len(values)
    return np.asarray(rows[rank:])


def find_structure(
    names: tuple[str, ...], sensitivities: Sequence[Array], unchanged: Callable[[Exponents], bool]
) -> ScalingStructure:
    """Find the symmetries in sensitivities `(T K, m)` at several points; `unchanged` proves one."""
    sensitivities = [root_of(s) for s in sensitivities]
    null = null_space(sensitivities)
    candidates = sparse_basis(null_space(sensitivities, nearly=True))
    proven = tuple(exponents for exponents in candidates if unchanged(exponents))
    each = [null_space([point]) for point in sensitivities if point.any()]
    blind = max(min(map(len, each), default=len(null)), len(proven))
    if blind > len(null):  # of a sum only the sum may show: its direction turns with its terms
        hidden = np.concatenate(each)
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
    """Return independent whole-number vectors in the span of `rows (n, m)`, n or fewer, the sparsest."""
    n, m = rows.shape
    candidates: set[Exponents] = set()
    for pivots in itertools.islice(itertools.combinations(range(m), n), MAX_BASES):
        block = rows[:, pivots]
        if n == 0 or np.linalg.cond(block) > 1e8:
            continue
        candidates |= {e for e in map(_whole, np.linalg.solve(block, rows)) if e is not None}
    independent: list[Exponents] = []
    for candidate in sorted(candidates, key=_complexity):
        more = np.array([*independent, candidate], dtype=float)
        if np.linalg.matrix_rank(more) > len(independent):
            independent.append(candidate)
    return tuple(independent)


def scaled_by_two(theta: Array, exponents: Exponents) -> Array:
    """Return `theta (..., D)` with each unknown times 2 to its exponent, which rounds nothing."""
    powers = np.zeros(theta.shape[-1])
    powers[: len(exponents)] = exponents
    return np.asarray(theta * 2.0**powers)


def _complement(rows: Array, m: int) -> Array:
    if len(rows) == 0:
        return np.eye(m)
    _, values, directions = np.linalg.svd(rows)
    return np.asarray(directions[int(np.sum(values > SAME_DIRECTION * values[0])) :])


def _whole(row: Array) -> Exponents | None:
    """The row times the least factor that makes all entries whole; None if there is none."""
    near = [Fraction(float(x)).limit_denominator(MAX_DENOMINATOR) for x in row]
    if any(abs(float(f) - x) > 1e-6 for f, x in zip(near, row, strict=True)):
        return None
    factor = math.lcm(*(f.denominator for f in near))
    whole = [int(f * factor) for f in near]
    divisor = math.gcd(*whole)
    if divisor == 0:
        return None
    sign = 1 if sum(whole) > 0 or (sum(whole) == 0 and next(x for x in whole if x) > 0) else -1
    return tuple(sign * x // divisor for x in whole)


def _complexity(exponents: Exponents) -> tuple[int, int, Exponents]:
    used = sum(x != 0 for x in exponents)
    return used, sum(abs(x) for x in exponents), tuple(-x for x in exponents)


NULL_BELOW, NULL_GAP = 1e-7, 1e-4  # of the largest singular value, and of that before
PRIOR_POINTS = 4  # beside the start: where symmetries are looked for and proven
# Of the way from the start to draws of the prior: rigs at ends of wide priors are so stiff that
# rounding hides what changes nothing.
PRIOR_SHARE = 0.25
MAX_DRAWS = 100  # of the prior, to find that many with a finite response


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
        there = likelihood.all_signals(scaled_by_two(points, exponents))
        return all(
            np.all(np.abs(x - y) <= SAME_RESPONSE * np.abs(x).max(axis=(0, 1)))
            for x, y in zip(signals, there, strict=True)
        )

    sensitivities = [sensitivity.sensitivities(point) for point in points]
    return find_structure(sensitivity.unknowns, sensitivities, unchanged)


FREED_RANGE = 0.5, 1.5  # times what is held: where the structure is looked at
MIN_PRIOR_SHARE = 0.5  # of a scale, what priors settle; of the largest part, what is named as well


@dataclass(frozen=True, slots=True, kw_only=True)
class DependsOnFixed:
    """A scale that numbers which are held fixed settle.

    With `exponents` of `names`, of which the last are `held`, no measured signal changes.
    `following (m, m)`: by how much the mean of each unknown's log follows the middle of each prior.
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
        """The unknowns that are known through what is held."""
        return tuple(name for name, e in self._powers.items() if e and name not in self.held)

    @property
    def through(self) -> tuple[str, ...]:
        """The numbers that are held and settle the scale."""
        return tuple(name for name, e in self._powers.items() if e and name in self.held)

    @property
    def narrowest(self) -> str:
        """The unknown that the record narrows most."""
        following = dict(zip(self.names, np.diag(self.following), strict=False))
        return min(self.unknown, key=following.__getitem__)

    def scales(self, names: Sequence[str], exponents: Sequence[float]) -> bool:
        """Return whether a product of powers is another where what is held is."""
        each = zip(names, exponents, strict=True)
        return sum(self._powers[name] * e for name, e in each) != 0

    def priors(self, names: Sequence[str], exponents: Sequence[float]) -> tuple[str, ...]:
        """Return whose priors settle a product that this scales; none where what is held does.

        What priors do together follows them all, and what is held the rest of the way.
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
    known: Information,
    prior_sd: Array,
    rng: np.random.Generator,
) -> tuple[DependsOnFixed, ...]:
    """Find scales that fixed numbers settle, where few are held and many rest on them.

    Who holds most of a rig knows that the rest is told through it.  `known` of the record at `theta
    (D,)`, `prior_sd (m,)` of the logs; `rng` draws the points at which the structure is looked at.
    """
    space, observations = posterior.space, posterior.likelihood.observations
    model = observations[0].response.model
    called = {x: n for each in observations for n, x in each.named(model.parameters).items()}
    fixed = tuple(name for name in called if space.fixed.get(name, 0.0) > 0.0)
    if not fixed:
        return ()
    values = [space.fixed[name] for name in fixed]
    low, high = FREED_RANGE
    wider = posterior.edit(
        free=[
            Unknown(
                symbol=dataclasses.replace(model.symbols[called[name]], name=name),
                role="rig",
                prior=Uniform(low=low * value, high=high * value),
                start=value,
            )
            for name, value in zip(fixed, values, strict=True)
        ]
    )
    at = np.insert(theta, len(space.columns("rig", "quantity")), values)
    structure = structure_of(wider, SensitivityStudy(wider.likelihood), at, rng)
    follows = prior_following(known, prior_sd)
    every = (
        DependsOnFixed(names=structure.names, exponents=e, held=fixed, following=follows)
        for e in structure.symmetries
    )
    return tuple(each for each in every if 0 < len(each.through) <= len(each.unknown))


def prior_following(known: Information, prior_sd: Array) -> Array:
    """Return how much the mean of each log follows the middle of each prior, `(m, m)`."""
    spread = np.linalg.inv(known.with_priors(prior_sd).root)
    return np.asarray(spread @ spread.T / prior_sd**2)
