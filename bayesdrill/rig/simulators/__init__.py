"""Simulators compute what the channels of an experiment do; here the right one is chosen."""

from __future__ import annotations

from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.contract import REVERSAL_SUBSTEPS, Simulator
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped


def simulator(
    model: Model,
    experiment: Experiment,
    sensing: ObservationModel,
    substeps: int = 1,
    reversal_substeps: int = REVERSAL_SUBSTEPS,
    adaptive: bool = False,
) -> Simulator:
    """Return the simulator that an experiment needs.

    `substeps`, `reversal_substeps`, `adaptive`: see `Stepping`, for what has to be stepped.
    """
    if not model.smooth or sensing.input_lags:
        return Stepped(model, experiment, sensing, substeps, reversal_substeps, adaptive)
    return Response(model, experiment, sensing)
