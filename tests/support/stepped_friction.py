"""`Stepped` at the cases of dry friction, as the tests of it want it."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from support.friction_cases import Case, moved_of
from support.small_problems import STATES, experiment

from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped


def model_of(case: Case) -> MotorShaft:
    added = tuple(name for name in MotorShaft.offers if name in case.added)
    return MotorShaft(i_m=case.rig.i_m, stribeck=case.rig.power, added=added)  # type: ignore[arg-type]


def experiment_of(
    case: Case, measures: Mapping[str, dict[str, float]] | None = None, **changes: Any
) -> Experiment:
    """Its record on every state, or on what `measures` says, without a number in it."""
    t, series = case.t, {"v": moved_of(case).v if case.v is None else case.v}
    if isinstance(case.t_1, np.ndarray):
        series["t_1"] = case.t_1
    made = experiment(
        len(t),
        float(t[1] - t[0]),
        first=float(t[0]),
        t_start=float(t[0]),
        constant={} if "t_1" in series else {"t_1": float(case.t_1)},
        series=series,
        first_order=case.first_order,
        start=dict(case.start),
        measures=dict(measures) if measures else None,
    )
    return replace(made, **changes)


def stepped(
    case: Case,
    pieces: int = 1,
    sensing: ObservationModel | None = None,
    record: Experiment | None = None,
) -> Stepped:
    return Stepped(
        model_of(case), record or experiment_of(case), sensing or ObservationModel(), pieces
    )


def parameters(case: Case, told: Mapping[str, float] | None = None) -> np.ndarray:
    """`(1, P)`: of the rig, then what sensors are `told`."""
    rig = [case.rig.p[name] for name in model_of(case).parameters]
    return np.array([[*rig, *(told or {}).values()]])


def states(case: Case, pieces: int) -> np.ndarray:
    """`(T, 5)`, at the case's times."""
    found = stepped(case, pieces).signals(parameters(case))[0]
    assert found.shape == (len(case.t), len(STATES))
    return np.asarray(found)
