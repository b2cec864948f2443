"""bayesdrill: Bayesian identification of the parameters of a torsional rig from records.

    import bayesdrill as bd

    case = bd.load("configs/nominal_step.yaml")     # or bd.case(...), from arrays
    case.identify()                                 # what this record can determine
    run = case.sample(case.find_map(), seed=1)
    run.judge(); run.plot_corner(); run.to_arviz()
    run.save("results/mine"); bd.open("results/mine")
    bd.overlay(["results/mine", run])               # several runs side by side
    bd.compare(["results/mine", run])               # the more probable of two models of one record

The commands on files and folders are functions too: `bd.init`, `bd.example`, `bd.simulate`,
`case.run`, `bd.publish`, `bd.calibration`, `bd.ladder`, `bd.campaign`, `bd.citation`.  Only these
and methods with a path as argument write files.  Results are immutable, and `print` shows them.
`help(bd.Case)` explains the usual order of work.
"""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING

from bayesdrill.basics.registry import lazy_attributes, public_names

if TYPE_CHECKING:
    from bayesdrill.analysis.verdict import Verdict as Verdict
    from bayesdrill.api.array_case import Channel as Channel
    from bayesdrill.api.array_case import Input as Input
    from bayesdrill.api.array_case import case as case
    from bayesdrill.api.campaign import Campaign as Campaign
    from bayesdrill.api.campaign import campaign as campaign
    from bayesdrill.api.campaign import watch as watch
    from bayesdrill.api.case import Case as Case
    from bayesdrill.api.case import load as load
    from bayesdrill.api.comparison import Comparison as Comparison
    from bayesdrill.api.comparison import Ladder as Ladder
    from bayesdrill.api.comparison import Overlay as Overlay
    from bayesdrill.api.comparison import compare as compare
    from bayesdrill.api.comparison import ladder as ladder
    from bayesdrill.api.comparison import overlay as overlay
    from bayesdrill.api.files import calibration as calibration
    from bayesdrill.api.files import citation as citation
    from bayesdrill.api.files import example as example
    from bayesdrill.api.files import export as export
    from bayesdrill.api.files import init as init
    from bayesdrill.api.files import publish as publish
    from bayesdrill.api.files import schema as schema
    from bayesdrill.api.files import verify as verify
    from bayesdrill.api.rig import nominal as nominal
    from bayesdrill.api.rig import respond as respond
    from bayesdrill.api.run import Best as Best
    from bayesdrill.api.run import Run as Run
    from bayesdrill.api.run import RunReport as RunReport
    from bayesdrill.api.run import open as open
    from bayesdrill.api.simulation import simulate as simulate
    from bayesdrill.basics.errors import InputError as InputError
    from bayesdrill.rig.models.long_shaft import LongShaft as LongShaft
    from bayesdrill.rig.models.motor_shaft import DrivenShaft as DrivenShaft
    from bayesdrill.rig.models.motor_shaft import Motor as Motor
    from bayesdrill.rig.models.motor_shaft import MotorShaft as MotorShaft
    from bayesdrill.rig.models.motor_shaft import TwoRotors as TwoRotors
    from bayesdrill.rig.models.train import Train as Train
    from bayesdrill.tasks.identify import Findings as Findings

# SciPy's Fourier transforms fail if one of these variables is set, but not to a number.
for _name in ("OMP_NUM_THREADS", "DUCC0_NUM_THREADS"):
    if not re.fullmatch(r"\s*\+?\d{1,9}\s*", os.environ.get(_name, "1")):
        del os.environ[_name]

__version__ = "0.2.0"

__all__ = ["__version__", *public_names(__name__)]

__getattr__ = lazy_attributes(__name__)  # so that `bayesdrill --help` does not load NumPy


def __dir__() -> list[str]:
    return [*__all__]
