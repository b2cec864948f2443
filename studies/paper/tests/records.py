"""Records of the nominal rig for the tests of the studies."""

import numpy as np
from numpy.typing import NDArray
from support.scipy_oracles import NOMINAL
from support.small_problems import noisy_step, posterior, with_start

from bayesdrill.inference import Posterior, Uniform

Array = NDArray[np.float64]

UNEVEN = np.array([0.02, 0.03, 0.05, 0.04])


def at(names: tuple[str, ...], *factors: float) -> dict[str, float]:
    """The nominal values of these, times factors."""
    return {name: NOMINAL[name] * f for name, f in zip(names, factors, strict=True)}


def target(
    names: tuple[str, ...],
    sigma: Array,
    n: int,
    start: dict[str, float],
    *,
    wide: tuple[float, float] = (0.1, 5.0),
) -> Posterior:
    """A record of the nominal rig with noise `sigma`; priors from `wide[0]` to `wide[1]` of nominal."""
    low, high = wide
    priors = {name: Uniform(low * NOMINAL[name], high * NOMINAL[name]) for name in names}
    found = posterior(noisy_step(sigma, n=n), sigma, free=names, priors=priors)
    return with_start(found, start)
