"""Steps of walkers that the proposal would hardly ever lead away.

Where the density p is far higher than the proposal q foresees, a walker waits for about p/q steps.
Those whose p/q is above a limit step by themselves, along the ridge that is likely theirs, to where
p/q is above the limit too: that is Metropolis and Hastings on the density cut to such places.  No
other walker is touched, so the whole density is kept exactly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesdrill.engines.samplers.mixture import Mixture

Array = NDArray[np.float64]

SHORTEST, LONGEST = 0.01, 1.0  # of a component's widths, over the root of the dimension


def steps(mixture: Mixture, u: Array, random: np.random.RandomState) -> tuple[Array, Array, Array]:
    """From `u (n, D)`: new points, their Hastings factors (logs) and their log q, both `(n,)`.

    The component is drawn by its share of q, which is another where the step ends; the step has its
    shape, and a length between far and near.
    """
    n, d = u.shape
    walker = np.arange(n)
    y, before = mixture.straightened(u)
    parts = mixture.log_parts(y, before)
    shares = np.exp(parts - parts.max(axis=0)).cumsum(axis=0)
    k = (shares < shares[-1] * random.random_sample(n)).sum(axis=0)
    length = SHORTEST * (LONGEST / SHORTEST) ** random.random_sample((n, 1)) / np.sqrt(d)
    step = np.einsum("nij,nj->ni", mixture.roots[k], random.standard_normal((n, d)))
    sheet = mixture.sheet[k]
    fresh = np.empty_like(u)
    for s in np.unique(sheet):
        mine = sheet == s
        fresh[mine] = mixture.sheets[s].bend((y[s] + length * step)[mine])[0]
    y, after = mixture.straightened(fresh)
    parts_after = mixture.log_parts(y, after)
    log_q, log_q_after = (np.logaddexp.reduce(some, axis=0) for some in (parts, parts_after))
    share, share_after = parts[k, walker] - log_q, parts_after[k, walker] - log_q_after
    factor = share_after - share + after[sheet, walker] - before[sheet, walker]
    return fresh, factor, log_q_after
