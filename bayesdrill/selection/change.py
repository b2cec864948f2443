"""Define a change of a config that may explain a bad fit, and the names of particular changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from bayesdrill.analysis.causes import NOISE, TORQUE
from bayesdrill.selection.config_edits import Entries, Place, leaves

UNKNOWN, AR1 = NOISE
BOTH = "friction_both"
# Names of changes of a whole rig or record; some of these changes need one of `Setting.numbers`.
START, MOMENT, GEAR, CLOCK, LATER = "free_start", "t_0", "gear", "clock", "later"
WIDENED = "prior_"  # prefix of the names of changes that widen the prior of an unknown

# A known sigma may be wrong by this factor, and the end of a log-uniform prior is moved by it.
WIDER = 10.0
# Kinds of physics, by the simulator that they need: linear, with Coulomb's law, or with another law.
# Candidates of one kind share kernels: each has all parameters of the kind, some at neutral values.
LINEAR, COULOMB, OTHER_LAW = 1, 2, 3
NOTHING: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Change:
    """A change of a model has `entries` that override those of the config; `description` describes it.

    `lacks` are the rig's parameters that the change introduces.  `requires` is a parameter that another
    change has to introduce, and `optional` an unknown that may be zero.  A change of physics has a
    `kind`, see `LINEAR`, and `neutral` values without effect.  Searches begin at `starts`.
    """

    name: str
    description: str
    entries: Entries
    lacks: tuple[str, ...] = ()
    requires: str = ""
    optional: str = ""
    kind: int = 0
    neutral: Mapping[str, float] = NOTHING
    starts: tuple[Mapping[str, float], ...] = ()

    @property
    def absorbs(self) -> bool:
        """Return whether the change absorbs any misfit without naming a cause."""
        return self.name in NOISE or self.name.startswith(TORQUE)

    @property
    def decides(self) -> frozenset[Place]:
        """Return the places in a config that the change sets; compatible changes share no place."""
        return frozenset(leaves(self.entries))
