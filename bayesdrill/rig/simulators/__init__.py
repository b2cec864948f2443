"""Simulators: what the channels of an experiment do. Here is chosen which one an experiment needs;
kernels are below.
"""

from __future__ import annotations

from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.contract import TURNS, Simulator
from bayesdrill.rig.simulators.exact import Response
from bayesdrill.rig.simulators.irregular import Measured
from bayesdrill.rig.simulators.sensors import Sensing
from bayesdrill.rig.simulators.stepped import Stepped


def simulator(
    model: Model,
    experiment: Experiment,
    sensing: Sensing,
    pieces: int = 1,
    turns: int = TURNS,
    chosen: bool = False,
) -> Simulator:
    """`pieces`, `turns`, `chosen`: see `Stepping`, of what has to be stepped."""
    if model.frictions or sensing.input_lags:
        return Stepped(model, experiment, sensing, pieces, turns, chosen)
    plain = sensing.nothing and experiment.uniform and bool(experiment.seen.all())
    return Response(model, experiment) if plain else Measured(model, experiment, sensing)
