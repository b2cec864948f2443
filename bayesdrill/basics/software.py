"""The software that a result is made with, and how it and the works it stands on are cited."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from importlib.resources import files

import bayesdrill

# A change of these may change the last bits of a chain: random streams and sums (numpy), priors and
# optimiser (scipy), steps (emcee), the compiled model (llvmlite).
DECISIVE = ("numpy", "scipy", "emcee", "llvmlite")
PACKAGES = (*DECISIVE, "arviz-stats", "arviz-base", "h5py")


def installed_versions() -> dict[str, str]:
    """Return the versions of this package and of those that results depend on."""
    return {"bayesdrill": bayesdrill.__version__, **{name: version(name) for name in PACKAGES}}


def version_differences(there: Mapping[str, str], wanted: Mapping[str, str]) -> list[str]:
    """Return what is `there` in another version than is `wanted`, with both."""
    return [f"{k} {there.get(k)} instead of {v}" for k, v in wanted.items() if there.get(k) != v]


def creator() -> str:
    """Return the name that figures carry inside."""
    return f"bayesdrill {bayesdrill.__version__}"


def versions_text() -> str:
    """Return the installed versions as one line."""
    return ", ".join(f"{name} {number}" for name, number in installed_versions().items())


def citation() -> str:
    """Return BibTeX entries of bayesdrill and of the works that its results stand on."""
    return files("bayesdrill").joinpath("citation.bib").read_text(encoding="utf-8")
