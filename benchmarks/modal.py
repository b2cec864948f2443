"""Coordinates by hand for the nine parameters: in logs of them the posterior is a thin bent ridge.

A record determines a steady speed and rates far better than the parameters in them.  With
rho = r_m/k_T and d = c_m + k_e/rho, the coordinates are the logs of

    speed        (v/rho - t_f)/d       of the motor
    rotor        k_s/j_1               square of the rotor's frequency
    shaft        i_m^2 k_s/d           stiffness over damping
    inertia      j_m/d                 mechanical time constant
    electrical   l_m/r_m               electrical time constant

and of c_m, t_f, j_1, r_m.  bayesdrill learns the like by itself; peers are given these.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from bayesdrill.config.job import Job

Array = NDArray[np.float64]
Known = dict[str, Any]  # logs

COORDINATES = ("speed", "rotor", "shaft", "inertia", "electrical", "c_m", "t_f", "j_1", "r_m")


@dataclass(frozen=True, slots=True)
class Modal:
    """Answers as `bayesdrill.coordinates.Coordinates`; `names`: the parameters, in their order.

    Coordinates of no positive parameters give NaN.
    """

    i_m: float
    v: float
    names: tuple[str, ...]

    between: ClassVar[tuple[tuple[int, float, float], ...]] = ()
    signed: ClassVar[tuple[tuple[int, float], ...]] = ()

    def from_physical(self, theta: Array) -> Array:
        p = dict(zip(self.names, theta.T, strict=True))
        rho = p["r_m"] / p["k_T"]
        d = p["c_m"] + p["k_e"] / rho
        speed = (self.v / rho - p["t_f"]) / d
        rates = p["k_s"] / p["j_1"], self.i_m**2 * p["k_s"] / d, p["j_m"] / d, p["l_m"] / p["r_m"]
        kept = (p[name] for name in COORDINATES[5:])
        with np.errstate(invalid="ignore"):
            return np.log(np.stack([speed, *rates, *kept], axis=-1))

    def to_physical(self, z: Array) -> Array:
        return self.with_jacobian(z)[0]

    def with_jacobian(self, z: Array) -> tuple[Array, Array]:
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            return self.physical(z, np)

    def physical(self, z: Any, xp: Any) -> tuple[Any, Any]:
        """`z (..., 9)` to `theta (..., 9)` and log |d theta / d z|; `xp` is NumPy or `jax.numpy`."""
        known = dict(zip(COORDINATES, xp.moveaxis(z, -1, 0), strict=True))
        d = self.damping(known)
        rho = self.resistance(known, d, xp)
        kappa = d + xp.log1p(-xp.exp(known["c_m"] - d))
        known["k_s"] = known["rotor"] + known["j_1"]
        known["j_m"] = known["inertia"] + d
        known["k_e"] = kappa + rho
        known["k_T"] = known["r_m"] - rho
        known["l_m"] = known["electrical"] + known["r_m"]
        logs = xp.stack([known[name] for name in self.names], axis=-1)
        # Slopes of the two curved equations, by kappa and by rho.
        friction = xp.exp(rho + known["t_f"] - math.log(self.v))
        log_det = d - kappa - xp.log1p(friction / (1.0 - friction))
        return xp.exp(logs), logs.sum(axis=-1) + log_det

    def damping(self, known: Known) -> Any:
        """log d."""
        return known["rotor"] + known["j_1"] + 2.0 * math.log(self.i_m) - known["shaft"]

    def resistance(self, known: Known, d: Any, xp: Any) -> Any:
        """log rho."""
        a = math.log(self.v) - known["speed"] - d
        return a - xp.log1p(xp.exp(a + known["t_f"] - math.log(self.v)))


def of(job: Job) -> Modal:
    model, constant = (
        job.problem.posterior.likelihood.only_observation.response.model,
        job.problem.experiment.constant,
    )
    if model.name != "motor_shaft" or len(job.problem.names) != 9 or "v" not in constant:
        raise ValueError("written for the nine parameters of a motor_shaft and a constant supply")
    return Modal(model.i_m, constant["v"], job.problem.names)
