"""Define targets of an experiment: parameters, products of powers, or formulas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.analysis.identifiability.information import Information, simple_exponents
from bayesdrill.analysis.identifiability.structure import Exponents, ScalingStructure
from bayesdrill.analysis.identifiability.study import KnownProduct, products
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import Dual, dual
from bayesdrill.basics.errors import Issue
from bayesdrill.basics.formulas import Expression, expression
from bayesdrill.config.schema.config import IdentifySpec
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.unknowns import SIMULATOR_ROLES, ParameterSpace
from bayesdrill.record.experiment import raise_if_any

UNCHANGED = 1e-9  # a target with a smaller relative derivative along a symmetry does not change
INDEPENDENT = 1e-8  # relative singular value below which targets are linearly dependent


@dataclass(frozen=True, slots=True)
class DesignTarget:
    """A target is a positive quantity whose relative sd the experiment is to reduce."""

    name: str
    formula: Expression

    def gradient(self, space: ParameterSpace, theta: Array) -> Array:
        """Return d log target / d u `(W, m)`; u is log unknown, or unknown / scale if signed."""
        value = self.formula.value(space.named_slopes(theta))
        if not isinstance(value, Dual):
            return np.zeros((len(theta), len(space.columns(*SIMULATOR_ROLES))))
        return np.asarray(value.slope / np.abs(dual(value).value))


def gradients(targets: Sequence[DesignTarget], space: ParameterSpace, theta: Array) -> Array:
    """Return the relative derivatives of targets, `(W, k, m)`."""
    return np.stack([target.gradient(space, theta) for target in targets], axis=1)


def parse_targets(problem: Problem, names: Sequence[str], theta: Array) -> tuple[DesignTarget, ...]:
    """Return the targets called `names`; raises `InputError` with all mistakes.

    A name is a parameter, a derived quantity of the config, or a formula.
    """
    space, targets, issues = problem.posterior.space, [], list[Issue]()
    known = [*space.named(theta[:1])]
    derived = {formula.symbol.name: formula.expression for formula in problem.derived}
    for name in dict.fromkeys(name.strip() for name in names):
        try:
            formula = derived.get(name) or expression(name, known)
        except ValueError as error:
            issues.append(Issue("--learn", str(error)))
            continue
        target = DesignTarget(name, formula)
        slopes = target.gradient(space, theta)
        if not np.isfinite(slopes).all():
            issues.append(Issue("--learn", f"{name} is not positive and finite at every draw"))
        elif not slopes.any():
            issues.append(Issue("--learn", f"{name} depends on no unknown of the rig"))
        else:
            targets.append(target)
    raise_if_any(issues)
    return tuple(targets)


def invariant_products(
    structure: ScalingStructure, information: Information, prior_sd: Array
) -> tuple[KnownProduct, ...]:
    """Return independent products that no exact symmetry changes, the most accurate first.

    `information` may come from any waveform, and ranks the products by their accuracy.
    """
    candidates = simple_exponents(len(structure.names))
    for symmetry in structure.symmetries:
        candidates = candidates[candidates @ np.array(symmetry, dtype=float) == 0.0]
    return products(information, prior_sd, candidates, IdentifySpec())


def product_target(names: Sequence[str], exponents: Exponents) -> DesignTarget:
    """Return the target that is a product of powers."""

    def side(sign: int) -> str:
        powers = [(n, sign * e) for n, e in zip(names, exponents, strict=True) if sign * e > 0]
        return "*".join(n if e == 1 else f"{n}**{e}" for n, e in powers)

    above, below = side(1), side(-1)
    name = above or "1"
    if below:
        name += f"/({below})" if "*" in below else f"/{below}"
    return DesignTarget(name, expression(name, names))


def hidden_by(slopes: Array, structure: ScalingStructure) -> tuple[Exponents, ...]:
    """Return the symmetries that change a target with relative derivatives `slopes (W, m)`."""
    count = len(structure.names)
    return tuple(
        e
        for e in structure.symmetries
        if np.abs(slopes[:, :count] @ np.array(e, dtype=float)).max() > UNCHANGED
    )


def independent(slopes: Array) -> list[int]:
    """Return indices of targets that are linearly independent of earlier ones at the first draw."""
    chosen: list[int] = []
    for k in range(slopes.shape[1]):
        values = np.linalg.svd(slopes[0, [*chosen, k]], compute_uv=False)
        if values[-1] > INDEPENDENT * values[0]:
            chosen.append(k)
    return chosen
