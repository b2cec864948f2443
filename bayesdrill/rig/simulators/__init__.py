"""Simulators compute the channels of an experiment; the choice of one for a record is made here.

- Dry friction or gravity, or inputs that lag each by a time of its own: `Stepped`, in steps of one
  length.
- Everything else is linear: `Response`, exact at any times, behind any sensors and of any size.
- Linear, nothing late, even times, noise that is white or AR(1), no missing torque, and more than
  `COMPRESSED_FROM` samples: `rig.compression`, as soon as a fit knows where the rig is.  Of any other
  record `exact_reason` says why it keeps all samples.
- With a missing torque the residuals of the simulator go through a Kalman filter (`kalman`).  It has
  one steady gain where times are even, no sample is missing and sensors are perfect; else a gain for
  each sample.
"""

from __future__ import annotations

from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.contract import REVERSAL_SUBSTEPS, Simulator
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped

COMPRESSED_FROM = 20_000  # samples: with fewer a run without compression takes some minutes at most


def simulator(
    model: Model,
    experiment: Experiment,
    sensing: ObservationModel,
    substeps: int = 1,
    reversal_substeps: int = REVERSAL_SUBSTEPS,
    adaptive: bool = False,
) -> Simulator:
    """Return the simulator that an experiment needs, which has all samples.

    `substeps`, `reversal_substeps`, `adaptive`: see `Stepping`, for what has to be stepped.
    """
    if not model.smooth or sensing.input_lags:
        return Stepped(model, experiment, sensing, substeps, reversal_substeps, adaptive)
    return Response(model, experiment, sensing)


def exact_reason(simulator: Simulator, *, gaussian: bool = True, torque: bool = False) -> str:
    """Say why a record cannot be compressed whatever the parameters; empty where it can.

    `gaussian`: whether its noise asks for sums of squares alone; `torque`: whether one is missing.
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
