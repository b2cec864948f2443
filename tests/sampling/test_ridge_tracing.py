"""A maximum in a corner of the priors, where the record would have more unknowns go further."""

from __future__ import annotations

import numpy as np
import pytest
from support.case_tables import for_each
from support.closed_form_densities import Walled

from bayesdrill.inference.laplace import QuadraticModel
from bayesdrill.sampling.proposal import ridge_tracing

D = 4
STILL = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]]).T / np.sqrt(2.0)


def test_all_that_is_held_back_and_all_that_changes_nothing_is_loose() -> None:

    def check(flat: int, pressed: int) -> None:
        walls = Walled(np.zeros(D), np.linspace(1.0, 2.0, D), 1.0)
        centre = np.where(np.arange(D) < pressed, walls.high, 0.1 * walls.high)
        still = STILL[:, :flat]
        whitened = 1e6 * (np.eye(D) - still @ still.T)
        slope = np.where(np.arange(D) < pressed, 1e4, 0.0)
        here = QuadraticModel(
            np.zeros(1), slope[None], (whitened / np.outer(walls.spread, walls.spread))[None]
        )
        base, known = ridge_tracing.split_directions(walls, centre, here, still)
        apart = np.linalg.matrix_rank(np.concatenate([still, np.eye(D)[:, :pressed]], axis=1))
        assert base.loose.shape == (D, apart)
        assert known.shape == (apart,)
        assert (known[:flat] == 0).all()
        assert (known[flat:] > 1e7).all()
        assert np.abs(base.tight[:pressed]).max(initial=0.0) < 1e-9
        u = centre + np.random.default_rng(1).normal(0, 0.1, (5, D))
        assert base.join(*base.split(u)) == pytest.approx(u, abs=1e-12)

    for_each(
        {f"{flat} {pressed}": (flat, pressed) for flat in [0, 1, 2] for pressed in [2, 3, 4]}, check
    )
