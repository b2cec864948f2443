"""Rigs that rub as sensors show them: other times, lags, gains, starts, against the oracle at those."""

import dataclasses
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from support.friction_cases import CASES, Case, moved_of
from support.friction_oracle import STATES, Moved, simulate
from support.stepped_friction import experiment_of, model_of, parameters

from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped

MEASURES = {"alpha": {"theta_1": 1.0, "theta_2": -1.0}, "w_1": {"w_1": 1.0}, "w_2": {"w_2": 8.0}}


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


TOLD = {"gain_alpha": 0.97, "offset_w_1": 0.3, "lag_alpha": 0.0243, "gain_v": 1.04}
TOLD |= {"offset_v": -0.2, "lag_v": 0.0052, "theta_2_0": 0.15, "w_1_0": 2.5, "i_0": 0.3}
