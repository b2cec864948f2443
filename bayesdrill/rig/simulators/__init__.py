"""Choose the simulator that computes the channels of an experiment.

- `Stepped` is for dry friction, gravity, and inputs with lags of their own.  Its steps are equal.
- `Response` is for all other rigs, which are linear.  It is exact, with any times and sensors.
- `rig.compression` is for linear rigs with even times, no delay, white or AR(1) noise, no missing
  torque, and more than `COMPRESSED_FROM` samples.  It is used once a fit has come near the maximum.
  `exact_reason` says why another record keeps all samples.
- `kalman` filters the residuals of a simulator if a torque is missing.  It has one steady gain if times
  are even, no sample is missing and sensors are perfect, and else a gain for each sample.
"""

from __future__ import annotations

from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.contract import REVERSAL_SUBSTEPS, Simulator
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped

COMPRESSED_FROM = 20_000  # samples; with fewer, an uncompressed run takes a few minutes at most


def simulator(
    model: Model,
    experiment: Experiment,
    sensing: ObservationModel,
    substeps: int = 1,
    reversal_substeps: int = REVERSAL_SUBSTEPS,
    adaptive: bool = False,
) -> Simulator:
    """Return the simulator that an experiment needs, which uses all samples.

    `Stepping` explains `substeps`, `reversal_substeps` and `adaptive` of a stepped rig.
    """
    if not model.smooth or sensing.input_lags:
        return Stepped(model, experiment, sensing, substeps, reversal_substeps, adaptive)
    return Response(model, experiment, sensing)


def exact_reason(simulator: Simulator, *, gaussian: bool = True, torque: bool = False) -> str:
    """Return why a record cannot be compressed whatever the parameters; empty if it can.

    `gaussian` says that its noise needs only sums of squares, and `torque` that one is missing.
    """
    reasons = {
        "a torque is missing": torque,
        "its noise is not Gaussian and even in time": not gaussian,
        "the rig has dry friction or inputs with lags, and is stepped": simulator.stepping
        is not None,
        "its channels are late, or its inputs": simulator.sensing.shifts,
        "its samples are not evenly spaced": not simulator.sensors.grid.uniform,
    }
    return next((reason for reason, holds in reasons.items() if holds), "")
