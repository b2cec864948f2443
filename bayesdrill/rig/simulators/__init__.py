"""Choose the simulator that computes the channels of an experiment.

- `Stepped` is for rigs that are not linear, and for inputs with lags of their own.  Its steps are equal.
- `Response` is for all other experiments.  It is exact for any sampling times and sensors.
- `rig.compression` is for linear rigs with even times, no delay, white or AR(1) noise, no missing
  torque, and more than `COMPRESSED_FROM` samples.  It is used once a fit has come near the maximum.
  `exact_reason` says why a record cannot be compressed.
- `kalman` filters the residuals of a simulator if a torque is missing.  Its gain is constant if
  times are even, no sample is missing and sensors are perfect; otherwise each sample has its own gain.
"""

from __future__ import annotations

from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.contract import REVERSAL_SUBSTEPS, Simulator
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped

COMPRESSED_FROM = 20_000  # samples; shorter records need only a few minutes without compression


def simulator(
    model: Model,
    experiment: Experiment,
    sensing: ObservationModel,
    substeps: int = 1,
    reversal_substeps: int = REVERSAL_SUBSTEPS,
    adaptive: bool = False,
) -> Simulator:
    """Return the simulator that uses all samples of an experiment.

    `substeps`, `reversal_substeps` and `adaptive` are the three fields of `Stepping`.
    """
    if not model.smooth or sensing.input_lags:
        return Stepped(model, experiment, sensing, substeps, reversal_substeps, adaptive)
    return Response(model, experiment, sensing)


def exact_reason(simulator: Simulator, *, gaussian: bool = True, torque: bool = False) -> str:
    """Return why a record cannot be compressed for any parameters; empty if it can.

    `gaussian` says that the likelihood needs only sums of squares, `torque` that a torque is missing.
    """
    reasons = {
        "a torque is missing": torque,
        "its likelihood needs more than sums of squared residuals": not gaussian,
        "the rig has dry friction or inputs with lags, and is stepped": simulator.stepping
        is not None,
        "its channels or inputs are delayed": simulator.sensing.shifts,
        "its samples are not evenly spaced": not simulator.sensors.grid.uniform,
    }
    return next((reason for reason, holds in reasons.items() if holds), "")
