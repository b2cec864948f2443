"""Rigs that rub as sensors show them: other times, lags, gains, starts, against the oracle at those."""

import dataclasses
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from support.friction_cases import CASES, Case, moved, moved_of
from support.friction_oracle import STATES, Moved, simulate
from support.stepped_friction import experiment_of, model_of, parameters, stepped

from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped

MEASURES = {"alpha": {"theta_1": 1.0, "theta_2": -1.0}, "w_1": {"w_1": 1.0}, "w_2": {"w_2": 8.0}}
UNEVEN = ("reversing", "static", "other")


def channels(found: Moved, measures: Mapping[str, Mapping[str, float]] = MEASURES) -> np.ndarray:
    """`(T, K)`."""
    rows = [[of.get(name, 0.0) for name in STATES] for of in measures.values()]
    return found.states @ np.array(rows).T


def between(case: Case, at: np.ndarray) -> Moved:
    """The oracle at any times from the start on, which are put in order for it."""
    order = np.unique(at)
    found = simulate(
        case.rig, case.t, moved_of(case).v, at=order,
        first_order=case.first_order, t_1=case.t_1, start=case.start,
    )  # fmt: skip
    place = np.searchsorted(order, at)
    return dataclasses.replace(found, t=at, states=found.states[place])


def near(found: np.ndarray, true: np.ndarray, share: float) -> bool:
    """To a share of the largest of each channel."""
    return bool((np.abs(found - true).max(axis=0) < share * np.abs(true).max(axis=0)).all())


def some(case: Case, *, jitter: float) -> np.ndarray:
    """Which samples are there, and by how much their times are off."""
    rng = np.random.default_rng(8)
    kept = np.ones(len(case.t), dtype=bool)
    kept[[7, 8, 40, 41, 42, 43, 200]] = False
    step = case.t[1] - case.t[0]
    return np.where(kept, jitter * step * rng.uniform(-0.5, 0.5, len(kept)), np.nan)


@pytest.mark.parametrize("jitter", [0.0, 0.6], ids=["gaps", "jitter"])
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n != "static")) for n in UNEVEN]
)
def test_signals_at_uneven_times_and_gaps_are_those_of_the_oracle(name: str, jitter: float) -> None:
    """Of a voltage that changes with them: what is held is held from sample to sample."""
    case = CASES[name]
    moves = some(case, jitter=jitter)
    moves[0] = 0.0
    here = ~np.isnan(moves)
    t, v = (case.t + moves)[here], moved_of(case).v[here]
    load = case.t_1[here] if isinstance(case.t_1, np.ndarray) else case.t_1
    other = dataclasses.replace(case, t=t, v=v, t_1=load)
    true = channels(other.moved())
    series = {"v": v} | ({"t_1": load} if isinstance(load, np.ndarray) else {})
    record = experiment_of(case, MEASURES)
    record = replace(record, t=t, y=np.zeros((len(t), 3)), series=series)
    found = [
        stepped(case, pieces, record=record).signals(parameters(case))[0] for pieces in (2, 16)
    ]
    off = [np.abs(one - true).max() / np.abs(true).max() for one in found]
    assert off[0] < 5e-2  # a held voltage that jumps within a step is its mean there
    assert off[1] < 4e-3
    assert off[1] < 0.5 * off[0]


def test_each_channel_has_its_own_lag_gain_and_offset() -> None:
    """Mutants killed: a lag of the wrong sign, an offset that the gain multiplies."""
    case = CASES["static"]
    step = case.t[1] - case.t[0]
    late = {"alpha": 2.4 * step, "w_2": -0.7 * step}
    sensing = ObservationModel(
        lags={"alpha": "lag_a", "w_2": "lag_w"}, gains={"alpha": "gain"}, offsets={"w_1": "offset"}
    )
    told = {"gain": 0.97, "offset": -1.5, "lag_a": late["alpha"], "lag_w": late["w_2"]}
    rig = stepped(case, 8, sensing, experiment_of(case, MEASURES))
    assert rig.parameters[-4:] == tuple(told)
    found = rig.signals(parameters(case, told))[0]
    inner = slice(3, -1)
    for k, name in enumerate(MEASURES):
        at = case.t[inner] - late.get(name, 0.0)
        true = channels(between(case, at))[:, k]
        true = true * (0.97 if name == "alpha" else 1.0) - (1.5 if name == "w_1" else 0.0)
        assert near(found[inner, k], true, 3e-3), name
    assert not found[0, 0]


@pytest.mark.parametrize("name", ["static", pytest.param("other", marks=pytest.mark.slow)])
@pytest.mark.parametrize("lag", [0.0123, pytest.param(0.02, marks=pytest.mark.slow), -0.0071])
def test_an_input_with_a_lag_acts_later(name: str, lag: float) -> None:
    """The rig feels now what the record has shown then; before it, and behind it, what is there first
    and last.  Mutant killed: a lag that goes the other way.
    """
    case, true_v = CASES[name], moved(name).v
    sensing = ObservationModel(input_lags={"v": "lag_v"})
    rig = stepped(case, 16, sensing, experiment_of(case, MEASURES))
    assert rig.parameters[-1] == "lag_v"
    found = rig.signals(parameters(case, {"lag_v": lag}))[0]
    true = channels(_felt(case, true_v, lag))
    assert near(found, true, 3e-3)
    other = channels(_felt(case, true_v, -lag))
    assert not near(found, other, 3e-3)


def _felt(case: Case, v: np.ndarray, lag: float) -> Moved:
    """With knots of the voltage moved by `lag`, and those of a load left where they are."""
    knots = np.union1d(case.t, case.t + lag)
    knots = knots[(knots >= case.t[0]) & (knots <= case.t[-1])]
    if case.first_order:
        felt = np.interp(knots - lag, case.t, v)
    else:
        places = np.searchsorted(case.t, knots - lag + 1e-9, side="right") - 1
        felt = v[np.clip(places, 0, len(v) - 1)]
    load = case.t_1
    if isinstance(load, np.ndarray):
        load = np.interp(knots, case.t, load)
    return simulate(
        case.rig, knots, felt, at=case.t, first_order=case.first_order, t_1=load, start=case.start
    )


def test_gain_and_offset_of_the_voltage_and_unknown_starts_move_the_rig() -> None:
    """Gain and offset of the voltage, and states of the start that are parameters."""
    case = CASES["static"]
    starts = {"theta_2": 0.4, "w_1": -2.0, "i": 0.3}
    sensing = ObservationModel(
        input_gains={"v": "gain_v"},
        input_offsets={"v": "offset_v"},
        states={name: f"{name}_0" for name in starts},
    )
    told = {"gain_v": 1.08, "offset_v": -0.2}
    told |= {f"{name}_0": value for name, value in starts.items()}
    found = stepped(case, 16, sensing, experiment_of(case, MEASURES)).signals(
        parameters(case, told)
    )[0]
    other = dataclasses.replace(case, v=1.08 * case.v - 0.2, start=starts)
    assert near(found, channels(other.moved()), 2e-3)


def test_the_rig_moves_from_a_start_before_the_first_sample() -> None:
    """Under the first voltage, from where the config says; here off the grid of the samples."""
    case = CASES["sine"]
    later = case.t[37:] - 0.0043
    begin = {"w_1": 1.5, "theta_1": 0.2}
    record = experiment_of(case, MEASURES)
    record = replace(
        record, t=later, y=np.zeros((len(later), 3)), series={"v": case.v[37:]},
        t_start=float(later[0] - 0.1312), start=begin,
    )  # fmt: skip
    found = Stepped(model_of(case), record, ObservationModel(), 16).signals(parameters(case))[0]
    knots = np.append(record.t_start, later)
    v = np.append(case.v[37], case.v[37:])
    true = simulate(case.rig, knots, v, at=later, start=begin)
    assert near(found, channels(true), 2e-3)


EVERY = ObservationModel(
    gains={"alpha": "gain_alpha"},
    offsets={"w_1": "offset_w_1"},
    lags={"alpha": "lag_alpha"},
    input_gains={"v": "gain_v"},
    input_offsets={"v": "offset_v"},
    input_lags={"v": "lag_v"},
    states={"theta_2": "theta_2_0", "w_1": "w_1_0", "i": "i_0"},
)
TOLD = {"gain_alpha": 0.97, "offset_w_1": 0.3, "lag_alpha": 0.0243, "gain_v": 1.04}
TOLD |= {"offset_v": -0.2, "lag_v": 0.0052, "theta_2_0": 0.15, "w_1_0": 2.5, "i_0": 0.3}


@pytest.mark.parametrize("name", ["static", pytest.param("other", marks=pytest.mark.slow)])
def test_slopes_are_those_of_its_own_signals(name: str) -> None:
    """Of every parameter, of sensors and start too; mutant killed: a lag of an input without a slope."""
    case = CASES[name]
    rig = stepped(case, 2, EVERY, experiment_of(case, MEASURES))
    assert rig.parameters[-len(TOLD) :] == tuple(TOLD)
    full = parameters(case, TOLD)
    along = np.diag(np.where(full[0] == 0.0, 1e-2, np.abs(full[0])))[None]
    signals, exact = rig.course(full, along)
    assert signals == pytest.approx(rig.signals(full), rel=1e-10, abs=1e-10)
    h = 1e-6
    rough = (rig.signals(full + h * along[0]) - rig.signals(full - h * along[0])) / (2 * h)
    for q, one in enumerate(rig.parameters):
        size = np.abs(rough[q]).max(axis=0)
        close = np.abs(exact[0, q] - rough[q]) < 1e-4 * size + 1e-7
        # A held voltage that jumps between the two sides leaves no slope there.
        assert close.mean() > (0.9 if "lag" in one else 0.97), one


def test_a_lag_of_whole_steps_is_exact_for_a_rig_without_friction() -> None:
    """Exactly, where the lag is whole steps."""
    case = CASES["other"]
    plain = dataclasses.replace(case.rig, p={n: x for n, x in case.rig.p.items() if n[:2] != "t_"})
    p = {**plain.p, "t_f": 0.01, "v_d": 0.0, "eta": 1.0}
    names = ("c_s", "j_2", "r_s", "c_1")
    rig = dataclasses.replace(plain, p=p)
    model = MotorShaft(i_m=rig.i_m, added=tuple(n for n in MotorShaft.offers if n in names))
    record = experiment_of(case, MEASURES)
    full = np.array([[*(p[name] for name in model.parameters), 0.016]])
    found = Stepped(model, record, ObservationModel(input_lags={"v": "late"}), 1).signals(full)[0]
    other = dataclasses.replace(case, rig=rig)
    assert near(found, channels(_felt(other, case.v, 0.016)), 1e-8)
