"""Rigs that rub, in steps: against the oracle in `friction_oracle`, and laws that no step may break."""

from dataclasses import replace

import numpy as np
import pytest
from support.case_tables import run_cases, slow_except
from support.friction_cases import CASES, moved
from support.friction_oracle import RUBS, simulate
from support.linear_oracle import ExactMotion
from support.stepped_friction import experiment_of, model_of, parameters, states, stepped

from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.contract import REVERSAL_SUBSTEPS
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped

W_1, W_2 = 2, 3
QUICK = ("stick slip", "falling", "straight", "other")
EVERY = slow_except(QUICK, CASES)
EFFORTS = slow_except(("falling", "other"), CASES)


def off(name: str, pieces: int) -> np.ndarray:
    """The largest distance from the oracle `(5,)`."""
    return np.asarray(np.abs(states(CASES[name], pieces) - moved(name).states).max(axis=0))


def test_a_step_in_which_a_speed_reverses_is_divided() -> None:
    """Each driven by what is there then; mutants killed: no parts, or one drive for all."""
    truth, rig = moved("straight").states, stepped(CASES["straight"])
    full = parameters(CASES["straight"])
    whole, parts = (
        np.abs(rig.with_substeps(1, turns).signals(full)[0] - truth).max(axis=0)[W_1]
        for turns in (1, REVERSAL_SUBSTEPS)
    )
    assert parts < 1e-4
    assert parts < 0.3 * whole


@pytest.mark.parametrize("name", EVERY)
def test_shorter_steps_converge_to_the_oracle(name: str) -> None:
    """128 times shorter: by more than first order, whatever happens in a step."""
    largest = np.abs(moved(name).states).max(axis=0)
    coarse, fine = off(name, 1) / largest, off(name, 128) / largest
    assert coarse.max() < 5e-2
    assert fine.max() < 2e-5
    assert fine.max() < coarse.max() / 128**1.5


@pytest.mark.parametrize("name", EFFORTS)
def test_efforts_are_the_means_of_the_oracle_over_a_step(name: str) -> None:
    """Its mean over a step: the same where nothing happens in it."""
    true, case = moved(name), CASES[name]
    motion = stepped(case, 16, record=experiment_of(case)).motion(parameters(case))
    found = motion.efforts[0]
    which = [RUBS.index(friction.name) for friction in model_of(case).frictions]
    assert which == [k for k in range(3) if case.rig.rubs[k]]
    step = case.t[1] - case.t[0]
    mean = np.diff(true.impulses[:, which], axis=0) / step
    size = np.abs(true.efforts[:, which]).max(axis=0)
    near = np.abs(found[:-1] - mean) / size
    assert np.quantile(near, 0.9, axis=0).max() < 0.03
    assert np.abs(found).max(axis=0) == pytest.approx(size, rel=0.05)
    # Strides from sample to sample are exact, where steps are nearly so.
    assert motion.states[0] == pytest.approx(states(case, 16), abs=3e-7)


@pytest.mark.parametrize("pieces", [1, 4])
@pytest.mark.parametrize("name", EVERY)
def test_a_sticking_inertia_does_not_move_at_all(name: str, pieces: int) -> None:
    """Mutants killed: a speed that is stopped to rounding only, an angle that creeps."""
    true, found = moved(name), states(CASES[name], pieces)
    for k, (angle, speed) in ((0, (1, W_2)), (1, (0, W_1))):
        held = true.stuck[:, k]
        # So long that steps cannot be in doubt of it.
        inside = np.flatnonzero(held[:-2] & held[1:-1] & held[2:]) + 1
        still = inside[found[inside, speed] == 0.0]
        assert len(still) >= 0.9 * len(inside)
        both = still[np.isin(still + 1, still)]
        assert (found[both + 1, angle] == found[both, angle]).all()
    drop = true.stuck[:-1, 2] & true.stuck[1:, 2]
    assert (found[1:, 4][drop] == 0.0).mean() > 0.9 if drop.any() else True


def test_the_rig_moves_from_a_start_before_the_first_sample() -> None:
    """Under the first voltage, from where the config says; here off the grid of the samples."""
    case = CASES["sine"]
    later, volts = case.t[37:237] - 0.0043, case.v[37:237]
    begin = {"w_1": 1.5, "theta_1": 0.2}
    start = float(later[0] - 0.1312)
    record = experiment_of(
        case, t=later, y=np.zeros((len(later), 5)), series={"v": volts}, t_start=start,
        start=begin,
    )  # fmt: skip
    found = stepped(case, 16, record=record).signals(parameters(case))[0]
    v = np.append(volts[0], volts)
    true = simulate(case.rig, np.append(start, later), v, at=later, start=begin).states
    assert (np.abs(found - true).max(axis=0) < 2e-3 * np.abs(true).max(axis=0)).all()


def test_frictions_of_no_size_leave_the_linear_rig() -> None:
    """To rounding, at any pieces, and for walkers that differ."""
    case = CASES["other"]
    nothing = {"eta": 1.0, "v_d": 0.0, "t_cm": 0.0, "t_sm": 0.0, "t_c1": 0.0, "t_s1": 0.0}
    nothing |= {"c_s": 0.0, "j_2": 0.0, "r_s": 0.0, "c_1": 0.0}
    model, record = model_of(case), experiment_of(case)
    rig = replace(case.rig, p={**case.rig.p, **nothing})
    full = np.array([[rig.p[name] for name in model.parameters]]).repeat(3, axis=0)
    full[:, :8] *= np.random.default_rng(2).uniform(0.8, 1.2, (3, 8))
    plain = MotorShaft(i_m=case.rig.i_m)
    true = np.array([ExactMotion(plain, record, row[:9]).signals() for row in full], dtype=float)
    for pieces in (1, 3):
        found = Stepped(model, record, ObservationModel(), pieces).signals(full)
        assert found == pytest.approx(true, rel=1e-9, abs=1e-9)


@run_cases("name", ["falling", "stick slip"])
def test_a_stride_is_as_long_as_the_way_to_the_next_sample(name: str) -> None:
    """A record with gaps, in which inputs stay what they are."""
    case, rng = CASES[name], np.random.default_rng(8)
    record = experiment_of(case)
    same = np.append(np.diff(case.v) == 0.0, False)
    kept = ~(np.roll(same, 1) & (rng.uniform(size=len(case.t)) < 0.2))
    kept[0] = True
    fewer = replace(
        record, t=record.t[kept], y=record.y[kept], series={"v": record.series["v"][kept]}
    )
    found = stepped(case, 8, record=fewer).signals(parameters(case))[0]
    assert 20 < np.count_nonzero(~kept) < 0.3 * len(kept)
    assert found == pytest.approx(states(case, 8)[kept], abs=3e-7)
