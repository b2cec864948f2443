"""The software that a result is made with."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version

import bayesdrill

# A change of these may change the last bits of a chain: random streams and sums (numpy), priors and
# optimiser (scipy), steps (emcee), the compiled model (llvmlite).
DECISIVE = ("numpy", "scipy", "emcee", "llvmlite")
PACKAGES = (*DECISIVE, "arviz-stats", "arviz-base", "h5py")


def versions() -> dict[str, str]:
    return {"bayesdrill": bayesdrill.__version__, **{name: version(name) for name in PACKAGES}}


def unlike(there: Mapping[str, str], wanted: Mapping[str, str]) -> list[str]:
    """What is `there` in another version than is `wanted`, with both."""
    return [f"{k} {there.get(k)} instead of {v}" for k, v in wanted.items() if there.get(k) != v]


def creator() -> str:
    """Inside of figures."""
    return f"bayesdrill {bayesdrill.__version__}"


def in_words() -> str:
    return ", ".join(f"{name} {number}" for name, number in versions().items())
