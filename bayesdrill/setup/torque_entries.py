"""What a config may say of a torque that its rig's equations leave out."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from bayesdrill.basics.entries import Strict
from bayesdrill.setup.number_entries import SigmaSpec


class MissingTorqueSpec(Strict):
    """A torque that the rig's equations are without, as a Gaussian process."""

    at: Literal["motor", "rotor_1"] = Field(
        description="The inertia on which it acts; at the motor, on its own side of the gear."
    )
    smoothness: Literal["1/2", "3/2"] = Field(
        "3/2", description="Of Matern: 1/2 jumps about, 3/2 has a rate."
    )
    size: SigmaSpec = Field(description="Its standard deviation [N m]: a number or a prior.")
    time: SigmaSpec = Field(description="After which it is forgotten [s]: a number or a prior.")
