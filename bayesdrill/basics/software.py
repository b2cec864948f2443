"""Return the versions of the software on which results depend, and the works to cite."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from importlib.resources import files

import bayesdrill

# With other versions of these packages, the last bits of a chain may differ: through random streams
# and sums (numpy), priors (scipy), steps (emcee) or machine code (llvmlite).
DECISIVE = ("numpy", "scipy", "emcee", "llvmlite")
PACKAGES = (*DECISIVE, "arviz-stats", "arviz-base", "h5py")


def installed_versions() -> dict[str, str]:
    """Return the versions of this package and of the libraries on which results depend."""
    return {"bayesdrill": bayesdrill.__version__, **_package_versions()}


@cache
def _package_versions() -> Mapping[str, str]:
    return {name: version(name) for name in PACKAGES}


def version_differences(used: Mapping[str, str], expected: Mapping[str, str]) -> list[str]:
    """Return a text for each package whose `used` version differs from the `expected` version."""
    return [f"{k} {used.get(k)} instead of {v}" for k, v in expected.items() if used.get(k) != v]


def creator() -> str:
    """Return the name and version of this package, for the metadata of figures."""
    return f"bayesdrill {bayesdrill.__version__}"


def versions_text() -> str:
    """Return the installed versions as one line."""
    return ", ".join(f"{name} {number}" for name, number in installed_versions().items())


def citation() -> str:
    """Return BibTeX entries for bayesdrill and for the publications of its methods."""
    return files("bayesdrill").joinpath("citation.bib").read_text(encoding="utf-8")
