"""bayesdrill: what a record says about the nine parameters of a torsional drilling rig.

    import bayesdrill as bd

    case = bd.load("configs/nominal_step.yaml")     # or bd.case(...), of arrays
    case.identify()                                 # what this record can show
    run = case.sample(case.find_map(), seed=1)
    run.judge(); run.plot_corner(); run.to_arviz()
    run.save("results/mine"); bd.open("results/mine")

All that is returned is a frozen record and prints itself in words; nothing but `save` writes.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayesdrill.api.case import Case as Case
    from bayesdrill.api.case import Channel as Channel
    from bayesdrill.api.case import Input as Input
    from bayesdrill.api.case import case as case
    from bayesdrill.api.case import load as load
    from bayesdrill.api.rig import nominal as nominal
    from bayesdrill.api.rig import respond as respond
    from bayesdrill.api.run import Best as Best
    from bayesdrill.api.run import Judged as Judged
    from bayesdrill.api.run import Run as Run
    from bayesdrill.api.run import open as open
    from bayesdrill.basics.errors import InputError as InputError
    from bayesdrill.rig.models.motor_shaft import MotorShaft as MotorShaft
    from bayesdrill.rig.models.two_rotors import TwoRotors as TwoRotors

__version__ = "0.1.0"

# Late: the command line has to answer before NumPy is loaded.
_PLACES = {
    "Case": "api.case",
    "Channel": "api.case",
    "Input": "api.case",
    "case": "api.case",
    "load": "api.case",
    "nominal": "api.rig",
    "respond": "api.rig",
    "Best": "api.run",
    "Judged": "api.run",
    "Run": "api.run",
    "open": "api.run",
    "InputError": "basics.errors",
    "MotorShaft": "rig.models.motor_shaft",
    "TwoRotors": "rig.models.two_rotors",
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"bayesdrill has no {name}; it has {', '.join(_PLACES)}")
    return getattr(importlib.import_module(f"bayesdrill.{_PLACES[name]}"), name)


def __dir__() -> list[str]:
    return [*_PLACES, "__version__"]
