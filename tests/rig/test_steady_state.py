"""Steady states: the solution of the equations of a turn, and none where there is none."""

import numpy as np
import pytest
import scipy.linalg

from bayesdrill.rig import steady_state


def test_an_equilibrium_is_refused_by_rank_alone() -> None:
    """Mutant killed: a small determinant taken for none."""
    stiff = scipy.linalg.hilbert(6)  # of full rank, and its determinant is 5e-18
    singular, unbounded = stiff.copy(), stiff.copy()
    singular[3], unbounded[0, 0] = singular[1] - singular[2], np.inf
    forcing = -np.sum(stiff, axis=1)
    found = steady_state.equilibrium(
        np.array([stiff, singular, unbounded]), np.array([forcing] * 3)
    )
    assert found[0] == pytest.approx(np.ones(6), rel=1e-6)
    assert np.isnan(found[1:]).all()


def test_a_rig_that_never_comes_to_rest_has_no_steady_state() -> None:
    """A torque on a rotor without friction; with friction it turns at torque over friction."""
    free = np.array([[[0.0, 1.0], [0.0, 0.0]], [[0.0, 1.0], [0.0, -0.5]]])
    turn = steady_state.free_turn(free, [0])
    found = steady_state.states(free, np.array([[0.0, 3.0], [0.0, 3.0]]), [0], turn)
    assert np.isnan(found[0, 1])
    assert found[1] == pytest.approx([0.0, 6.0])
