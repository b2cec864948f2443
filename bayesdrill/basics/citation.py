"""How bayesdrill and what it stands on are cited: one list of works, as text, BibTeX or CITATION.cff."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import bayesdrill
from bayesdrill.basics import bibliography, software
from bayesdrill.basics.bibliography import Work

RELEASED = "2026-11-22"  # the day of `__version__`, as CHANGELOG.md has it
LICENCE = "MIT"
ABOUT = "What a record says about the nine parameters of a torsional drilling rig"


BAYESDRILL = Work(
    key="bayesdrill",
    kind="software",
    authors=(("The bayesdrill developers", ""),),
    title=f"bayesdrill: {ABOUT[0].lower()}{ABOUT[1:]}",
    year=RELEASED[:4],
)
PAPER = Work(
    key="sandoval2013",
    kind="conference-paper",
    authors=(("Sandoval", "Mario Germán"), ("Cunha Jr", "Americo"), ("Sampaio", "Rubens")),
    title="Identification of parameters in the torsional dynamics of a drilling process "
    "through Bayesian statistics",
    year="2013",
    within="ENIEF 2013",
    arxiv="2107.13535",
)
# As emcee and ArviZ ask to be cited; a test reads it off the installed packages.
EMCEE = Work(
    key="emcee",
    kind="article",
    authors=(("Foreman-Mackey", "D."), ("Hogg", "D. W."), ("Lang", "D."), ("Goodman", "J.")),
    title="emcee: The MCMC Hammer",
    year="2013",
    within="Publications of the Astronomical Society of the Pacific",
    volume="125",
    pages=("306", "312"),
    doi="10.1086/670067",
    arxiv="1202.3665",
)
ARVIZ = Work(
    key="arviz",
    kind="article",
    authors=(
        ("Martin", "Osvaldo A."),
        ("Abril-Pla", "Oriol"),
        ("Deklerk", "Jordan"),
        ("Axen", "Seth D."),
        ("Carroll", "Colin"),
        ("Hartikainen", "Ari"),
        ("Vehtari", "Aki"),
    ),
    title="ArviZ: a modular and flexible library for exploratory analysis of Bayesian models",
    year="2026",
    within="Journal of Open Source Software",
    volume="11",
    issue="119",
    pages=("9889",),
    doi="10.21105/joss.09889",
)


@dataclass(frozen=True, slots=True)
class Citation:
    """`sentence`: for a section on methods; it names the works by the keys of the BibTeX entries."""

    sentence: str
    works: tuple[Work, ...]

    @property
    def text(self) -> str:
        return "\n".join(
            [self.sentence, "", *(f"[{work.key}] {bibliography.line(work)}" for work in self.works)]
        )

    @property
    def bibtex(self) -> str:
        return "\n\n".join(bibliography.bibtex(work) for work in self.works)

    @property
    def cff(self) -> str:
        """`CITATION.cff`, by the Citation File Format 1.2.0."""
        own, *others = self.works
        about = {
            "cff-version": "1.2.0",
            "message": "Please cite bayesdrill, and the works below that a result stands on.",
            "abstract": f"{ABOUT}.",
            "license": LICENCE,
            **({"date-released": RELEASED} if own.year else {}),
            **{name: value for name, value in bibliography.cff(own).items() if name != "year"},
            "references": [bibliography.cff(work) for work in others],
        }
        return _yaml(about)

    def __str__(self) -> str:
        return self.text


def citation(versions: Mapping[str, str] | None = None) -> Citation:
    """How to cite what a result was made with; `versions`: those of its run, or of what is installed."""
    used = {**software.versions(), **(versions or {})}
    number = used["bayesdrill"]
    # When another version was released is not known here.
    own = replace(
        BAYESDRILL, version=number, year=RELEASED[:4] * (number == bayesdrill.__version__)
    )
    sentence = (
        f"The posterior was computed with bayesdrill {number} [{own.key}], "
        f"on a model of the rig of [{PAPER.key}], sampled with emcee {used['emcee']} [{EMCEE.key}] "
        f"and diagnosed with ArviZ (arviz-stats {used['arviz-stats']}) [{ARVIZ.key}]."
    )
    return Citation(sentence, (own, PAPER, EMCEE, ARVIZ))


def _yaml(data: Mapping[str, Any]) -> str:
    from ruamel.yaml import YAML

    out, yaml = io.StringIO(), YAML()
    yaml.width = 100
    yaml.indent(mapping=2, sequence=4, offset=2)
    yaml.dump(dict(data), out)
    return out.getvalue()
