"""The coordinates made by hand in JAX, and the same without the walls of the box.

Friction takes less than half of the stall torque all over the box of the priors, so that a speed
is all that its equation needs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from bayesdrill.config.job import Job
from benchmarks import modal
from benchmarks.modal import COORDINATES, Known
from benchmarks.peers.response_jax import Density, log_likelihood

KEPT = ("j_1", "t_f", "c_m", "r_m")  # in an order in which each one's ends follow from those before

Map = Callable[[Any], tuple[Any, Any]]


def physical_from_modal(job: Job) -> Map:
    """`z (9,)` to `theta (9,)` and log |d theta / d z|."""
    straight = modal.of(job)
    return lambda z: straight.physical(z, jnp)


def modal_density(job: Job) -> Density:
    """`z (9,)` to a number, up to a constant; -inf outside the box of the priors."""
    record, theta_of = log_likelihood(job), physical_from_modal(job)
    low, high = (jnp.array(end) for end in job.problem.posterior.space.box[1:3])

    def density(z: Any) -> Any:
        theta, log_det = theta_of(z)
        inside = jnp.all((theta >= low) & (theta <= high))
        # Where z belongs to no parameters the gradient of what is not chosen must be finite too.
        safe = jnp.where(inside, theta, 0.5 * (low + high))
        return jnp.where(inside, record(safe) + log_det, -jnp.inf)

    return density


def unfolded_density(job: Job) -> Density:
    """`u (9,)` to a number, up to a constant: the box of the priors has no walls in u."""
    density, modal_of = modal_density(job), modal_from_unfolded(job)

    def of(u: Any) -> Any:
        z, log_det = modal_of(u)
        return jnp.where(jnp.isfinite(log_det), density(z) + log_det, -jnp.inf)

    return of


def modal_from_unfolded(job: Job) -> Map:
    """The targets as they are; each kept log from the logit of its place between its ends."""
    ends = _ends(job)

    def modal_of(u: Any) -> tuple[Any, Any]:
        known = dict(zip(COORDINATES, u, strict=True))
        log_det: Any = 0.0
        for name in KEPT:
            low, high = ends(name, known)
            width = jnp.where(high > low, high - low, 1.0)
            log_det += jnp.where(high > low, jnp.log(width), -jnp.inf)
            log_det += jax.nn.log_sigmoid(known[name]) + jax.nn.log_sigmoid(-known[name])
            known[name] = low + width * jax.nn.sigmoid(known[name])
        return jnp.stack([known[name] for name in COORDINATES]), log_det

    return modal_of


def unfolded_from_modal(job: Job) -> Callable[[Any], Any]:
    ends = _ends(job)

    def unfold(z: Any) -> Any:
        known = dict(zip(COORDINATES, z, strict=True))
        places = dict(known)
        for name in KEPT:
            low, high = ends(name, known)
            share = (known[name] - low) / (high - low)
            places[name] = jnp.log(share) - jnp.log1p(-share)
        return jnp.stack([places[name] for name in COORDINATES])

    return unfold


def _ends(job: Job) -> Callable[[str, Known], tuple[Any, Any]]:
    """Between which logs a kept parameter may lie for all nine to be in the box of the priors."""
    straight, box = modal.of(job), job.problem.posterior.space.box
    low = {name: math.log(x) for name, x in zip(job.problem.names, box[1], strict=True)}
    high = {name: math.log(x) for name, x in zip(job.problem.names, box[2], strict=True)}

    def ends(name: str, known: Known) -> tuple[Any, Any]:
        if name == "t_f":
            return low[name], high[name]
        if name == "j_1":
            shifts = {"j_1": 0.0, "k_s": known["rotor"]}
            shifts["j_m"] = known["inertia"] + straight.damping(known | {"j_1": 0.0})
            return _between({k: (low[k], high[k]) for k in shifts}, shifts)
        d = straight.damping(known)
        rho = straight.resistance(known, d, jnp)
        if name == "r_m":
            shifts = {"r_m": 0.0, "l_m": known["electrical"], "k_T": -rho}
            return _between({k: (low[k], high[k]) for k in shifts}, shifts)
        # exp(c_m) = exp(d) - exp(k_e - rho): falls as k_e rises.
        least, most = _rest(d, high["k_e"] - rho), _rest(d, low["k_e"] - rho)
        return jnp.maximum(low["c_m"], least), jnp.minimum(high["c_m"], most)

    return ends


def _between(box: dict[str, tuple[float, float]], shifts: Known) -> tuple[Any, Any]:
    """Of x, where every x + shift is in its interval."""
    lower = jnp.stack([jnp.asarray(box[name][0] - shift) for name, shift in shifts.items()])
    upper = jnp.stack([jnp.asarray(box[name][1] - shift) for name, shift in shifts.items()])
    return lower.max(), upper.min()


def _rest(d: Any, kappa: Any) -> Any:
    """log(exp(d) - exp(kappa)); far below any parameter where that is not positive."""
    return jnp.where(d > kappa, d + jnp.log1p(-jnp.exp(jnp.minimum(kappa - d, -1e-12))), -100.0)
