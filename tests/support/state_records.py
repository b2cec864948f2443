"""Records without numbers in them, of rigs whose states are all shown."""

from collections.abc import Mapping

import numpy as np

from bayesdrill.record.experiment import Channel, Experiment
from bayesdrill.rig.models.linear import Model


def record_of_states(
    rig: Model, t: np.ndarray, series: Mapping[str, np.ndarray], *, first_order: bool = False
) -> Experiment:
    """Return the record of a rig that is at rest at first, with a channel for each state."""
    channels = tuple(
        Channel(name=name, weights={name: 1.0}, unit="", latex="", latex_unit="")
        for name in rig.states
    )
    return Experiment(
        t=t, y=np.zeros((len(t), len(channels))), channels=channels, constant={},
        series=dict(series), first_order=first_order, start={}, t_start=0.0,
    )  # fmt: skip
