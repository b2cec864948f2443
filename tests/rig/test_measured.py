"""Sensors and starts: against the plain response with times moved by hand, and their slopes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles import NOMINAL
from rigs import experiment, vector
from together import for_each

from bayesdrill.record.experiment import Experiment
from bayesdrill.rig import steady_state
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.exact import Response
from bayesdrill.rig.simulators.irregular import IrregularSimulator
from bayesdrill.rig.simulators.sensors import ObservationModel

THETA = vector(NOMINAL) * np.linspace(0.85, 1.2, 9)
MEASURES = {"alpha": {"theta_1": 1.0, "theta_2": -1.0}, "w_2": {"w_2": 8.0}, "i": {"i": 1.0}}
VOLTAGE = 6.0 * np.sign(np.sin(np.arange(120) * 0.21)) + 0.5 * np.cos(np.arange(120) * 0.05)


def uneven(n: int = 120, dt: float = 0.01) -> np.ndarray:
    rng = np.random.default_rng(3)
    t = 2.5 + dt * (np.arange(n) + 0.3 * rng.uniform(-1, 1, n))
    return np.delete(t, [7, 8, 40])


def in_motion(t: np.ndarray, *, first_order: bool = False, **changes: object) -> Experiment:
    grid = 2.5 + 0.01 * np.arange(120)
    series = {"v": np.interp(t, grid, VOLTAGE)}
    made = experiment(
        120,
        0.01,
        first=2.5,
        t_start=2.5,
        constant={"t_1": 0.1},
        series={"v": VOLTAGE},
        first_order=first_order,
        start={"theta_1": 0.2, "theta_2": -0.1, "w_1": 3.0, "w_2": 2.0, "i": 0.4},
        measures=MEASURES,
    )
    return replace(made, t=t, y=np.zeros((len(t), 3)), series=series, **changes)


def moved(times: np.ndarray, first_order: bool) -> np.ndarray:
    """States of the rig at `times`, from the plain response on a grid that holds them all."""
    fine = 0.0005
    t = 2.5 + fine * np.arange(round((times.max() - 2.5) / fine) + 1)
    grid = 2.5 + 0.01 * np.arange(120)
    held = np.floor((t - 2.5) / 0.01 + 1e-9).astype(int).clip(max=119)
    v = np.interp(t, grid, VOLTAGE) if first_order else VOLTAGE[held]
    dense = replace(in_motion(grid, first_order=first_order), t=t, y=np.zeros((len(t), 3)))
    dense = replace(dense, series={"v": v})
    found = Response(MotorShaft(), dense).signals(THETA[None])[0]
    return found[np.round((times - 2.5) / fine).astype(int)]


def test_lag_gain_and_offset_of_each_channel() -> None:
    """Mutants killed: a lag of the wrong sign, an offset that the gain multiplies."""

    def check(first_order: bool) -> None:
        t = 2.5 + 0.01 * np.arange(120)
        one = in_motion(t, first_order=first_order)
        sensing = ObservationModel(
            gains={"alpha": "gain_alpha"},
            offsets={"alpha": "offset_alpha", "w_2": "offset_w_2"},
            lags={"alpha": "lag_alpha", "i": "lag_i"},
        )
        rig = IrregularSimulator(MotorShaft(), one, sensing)
        assert rig.parameters[9:] == (
            "gain_alpha",
            "offset_alpha",
            "offset_w_2",
            "lag_alpha",
            "lag_i",
        )
        shown = rig.signals(np.append(THETA, [0.97, 0.02, -1.5, 0.024, 0.0035])[None])[0]
        late = {0: 0.024, 1: 0.0, 2: 0.0035}
        for k, (gain, offset) in enumerate([(0.97, 0.02), (1.0, -1.5), (1.0, 0.0)]):
            seen = t - late[k] >= 2.5
            expected = gain * moved((t - late[k])[seen], first_order)[:, k] + offset
            assert shown[seen, k] == pytest.approx(expected, rel=1e-9, abs=1e-9)

    for_each({str(first_order): (first_order,) for first_order in [False, True]}, check)


def test_a_step_given_late() -> None:
    """Until then the rig stands; then it does what it would have done earlier."""
    one = experiment(200, 0.01, measures=MEASURES, constant={"v": 8.0})
    rig = IrregularSimulator(MotorShaft(), one, ObservationModel(delay="t_0"))
    shown = rig.signals(np.append(THETA, 0.0537)[None])[0]
    fine = Response(MotorShaft(), experiment(20000, 0.0001, measures=MEASURES, constant={"v": 8.0}))
    expected = fine.signals(THETA[None])[0]
    assert not shown[:6].any()
    assert shown[6:] == pytest.approx(expected[np.arange(6, 200) * 100 - 537], rel=1e-9, abs=1e-10)


def test_what_the_supply_adds() -> None:
    """Of a measured voltage and of a constant one; mutant killed: the offset taken twice."""
    sensing = ObservationModel(input_gains={"v": "gain_v"}, input_offsets={"v": "offset_v"})
    one = in_motion(2.5 + 0.01 * np.arange(120))
    shown = IrregularSimulator(MotorShaft(), one, sensing).signals(
        np.append(THETA, [1.1, -0.3])[None]
    )
    other = replace(one, series={"v": 1.1 * VOLTAGE - 0.3})
    assert shown == pytest.approx(Response(MotorShaft(), other).signals(THETA[None]), rel=1e-10)
    fixed = experiment(50, 0.01, measures=MEASURES, constant={"v": 5.0})
    shown = IrregularSimulator(MotorShaft(), fixed, sensing).signals(
        np.append(THETA, [1.1, -0.3])[None]
    )
    fixed = replace(fixed, constant={"v": 5.2})
    assert shown == pytest.approx(Response(MotorShaft(), fixed).signals(THETA[None]), rel=1e-10)


def test_a_steady_start_stays_steady() -> None:
    one = experiment(300, 0.01, measures=MEASURES, constant={"v": 6.0}, start={"theta_2": 1.5})
    rig = IrregularSimulator(MotorShaft(), one, ObservationModel(steady=True))
    shown = rig.signals(THETA[None])[0]
    assert shown == pytest.approx(np.broadcast_to(shown[0], shown.shape), rel=1e-9)
    assert shown[0, 1] > 1
    states = replace(one, channels=experiment(2).channels, y=np.zeros((300, 5)))
    assert (
        IrregularSimulator(MotorShaft(), states, ObservationModel(steady=True)).signals(
            THETA[None]
        )[0, 0, 1]
        == 1.5
    )


def test_a_rig_that_never_comes_to_rest_has_no_steady_state() -> None:
    """A torque on a rotor without friction; with friction it turns at torque over friction."""
    free = np.array([[[0.0, 1.0], [0.0, 0.0]], [[0.0, 1.0], [0.0, -0.5]]])
    turn = steady_state.free_turn(free, [0])
    found = steady_state.states(free, np.array([[0.0, 3.0], [0.0, 3.0]]), [0], turn)
    assert np.isnan(found[0, 1])
    assert found[1] == pytest.approx([0.0, 6.0])


def test_without_what_is_not_seen_sums_are_those_of_the_rest() -> None:
    one = in_motion(uneven())
    y = np.random.default_rng(1).normal(size=one.y.shape)
    y[3, 1] = y[20:30, 0] = np.nan
    rig = simulator(MotorShaft(), replace(one, y=y), ObservationModel())
    assert isinstance(rig, IrregularSimulator)
    left = y - rig.signals(THETA[None])[0]
    assert rig.squares(THETA[None])[0] == pytest.approx(np.nansum(left**2, axis=0), rel=1e-12)
    assert isinstance(simulator(MotorShaft(), in_motion(one.t[:2]), ObservationModel()), Response)


EVERY = ObservationModel(
    gains={"alpha": "gain_alpha", "w_2": "gain_w_2"},
    offsets={"alpha": "offset_alpha"},
    lags={"alpha": "lag_alpha", "i": "lag_i"},
    input_gains={"v": "gain_v"},
    input_offsets={"v": "offset_v"},
    delay="lag_v",
    states={"theta_2": "theta_2_0", "w_1": "w_1_0", "i": "i_0"},
)
TOLD = np.array([0.97, 1.02, 0.01, 0.0243, 0.0031, 1.04, -0.2, 0.0052, 0.15, 2.5, 0.3])


def test_slopes_are_those_of_the_signals() -> None:
    """By central differences of each number alone; mutants killed: a lag's slope before the start, that
    of a steady start.
    """

    def check(first_order: bool, steady: bool) -> None:
        sensing, told = EVERY, TOLD
        if steady:
            sensing, told = replace(EVERY, steady=True, states={"theta_2": "theta_2_0"}), TOLD[:-2]
        one = in_motion(uneven(60), first_order=first_order)
        rig = IrregularSimulator(MotorShaft(), one, sensing)
        full = np.append(THETA, told)[None]
        along = np.diag(np.abs(full[0]))[None]
        exact = rig.sensitivities(full, along)[0]
        h = 1e-6
        up = rig.signals(full + h * along[0])
        down = rig.signals(full - h * along[0])
        rough = (up - down) / (2 * h)
        for q, name in enumerate(rig.parameters):
            close = np.isclose(
                exact[q], rough[q], rtol=1e-4, atol=1e-6 * np.abs(rough[q]).max() + 1e-9
            )
            # A held voltage that jumps between the two sides leaves no slope there.
            assert close.mean() > (0.95 if "lag" in name else 1.0) - 1e-9, name

    for_each(
        {
            f"{first_order} {steady}": (first_order, steady)
            for first_order in [False, True]
            for steady in [False, True]
        },
        check,
    )


def test_slopes_of_a_steady_start_leave_a_held_angle_where_it_is() -> None:
    """Mutant killed: the slope of a steady start without the angle that is held."""
    angles = {name: {name: 1.0} for name in ("theta_1", "theta_2")}
    one = experiment(40, 0.02, measures=angles, constant={"v": 6.0}, start={"theta_2": 1.5})
    rig = IrregularSimulator(MotorShaft(), one, ObservationModel(steady=True))
    along = np.diag(THETA)[None]
    exact = rig.sensitivities(THETA[None], along)[0]
    h = 1e-5
    rough = (rig.signals(THETA + h * along[0]) - rig.signals(THETA - h * along[0])) / (2 * h)
    assert exact == pytest.approx(rough, rel=1e-5, abs=1e-8)
    assert not exact[:, 0, 1].any()


def test_normal_equations_are_sums_of_slopes() -> None:
    one = in_motion(uneven())
    y = np.random.default_rng(4).normal(size=one.y.shape)
    y[5:9, 2] = np.nan
    rig = IrregularSimulator(MotorShaft(), replace(one, y=y), EVERY)
    full = np.append(THETA, TOLD) * np.array([[1.0], [1.01]])
    along = np.random.default_rng(5).normal(size=(2, 4, full.shape[1])) * full[:, None, :]
    scales = np.array([[1.0, 0.5, 2.0], [3.0, 1.0, 0.1]])
    squares, slopes, products = rig.normal(full, along, scales[..., None] ** 2)
    seen = ~np.isnan(y)
    left = np.where(seen, y - rig.signals(full), 0) * scales[:, None]
    shown = np.where(seen, rig.sensitivities(full, along), 0) * scales[:, None, None]
    assert squares == pytest.approx((left**2).sum(axis=1))
    assert slopes == pytest.approx(np.einsum("wqtk,wtk->wq", shown, left))
    assert products == pytest.approx(np.einsum("wqtk,wptk->wqp", shown, shown))
