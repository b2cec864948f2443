"""Where polynomials are no match for a ridge: Gauss and Newton bring every point of it home.

A draw, with its density on the way there and back, costs some hundred times as much as a response.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesdrill.engines.learning.directions import Expand
from bayesdrill.engines.learning.ridges import led_back
from bayesdrill.engines.samplers import ridge
from bayesdrill.engines.samplers.independence import Proposal
from bayesdrill.engines.samplers.mixture import Mixture
from bayesdrill.engines.samplers.ridge import Frame, Sheet
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.surface import PosteriorSurface

Array = NDArray[np.float64]

NEAR = 0.5  # standard deviations: from there another step leads to the ridge, or as good as
ITERATIONS = 9  # where polynomials are far astray, half of them are spent on the way


@dataclass(frozen=True, slots=True)
class Settled:
    """`ridge`, from whose place and root each point is brought to where the ridge is.

    A function of psi alone, whether or not it arrives.
    """

    ridge: Sheet
    expand: Expand

    @property
    def frame(self) -> Frame:
        return self.ridge.frame

    @property
    def n_loose(self) -> int:
        return self.ridge.n_loose

    def along(self, psi: Array) -> tuple[Array, Array, Array]:
        place, root, log_det = self.ridge.along(psi)
        found, roots, _, arrived = led_back(self.expand, self.frame, psi, place, NEAR, ITERATIONS)
        row = np.arange(place.shape[1])
        place = np.where(arrived[:, None], found, place)
        root[:, :, arrived] = np.moveaxis(roots[arrived], 0, 2)
        log_det[arrived] = np.log(root[row, row][:, arrived]).sum(axis=0)
        return place, root, log_det

    def within(self, psi: Array) -> NDArray[np.bool_]:
        return self.ridge.within(psi)

    def bend(self, y: Array) -> tuple[Array, Array]:
        return ridge.bend(self, y)

    def straighten(self, u: Array) -> tuple[Array, Array]:
        return ridge.straighten(self, u)


def bound(proposal: Proposal, posterior: Posterior) -> Proposal:
    """With the ridges of its `settled` part, where it has one, brought home along the posterior."""
    own = proposal.settled
    if own is None:
        return proposal
    expand = PosteriorSurface(posterior).bent
    return replace(proposal, settled=replace(own, mixture=settled(own.mixture, expand)))


def settled(found: Mixture, expand: Expand) -> Mixture:
    """The same mixture over settled ridges."""
    return replace(found, sheets=tuple(Settled(sheet, expand) for sheet in found.sheets))
