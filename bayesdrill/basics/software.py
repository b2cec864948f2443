"""The software that a result is made with, and how it and the works it stands on are cited."""

from __future__ import annotations

import io
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

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


@dataclass(frozen=True, slots=True)
class Work:
    """A work to cite, its `kind` of CFF; `authors`: (family, given) or (group, ""); `pages`: ends."""

    key: str
    kind: str
    authors: tuple[tuple[str, str], ...]
    title: str
    year: str
    within: str = ""
    volume: str = ""
    issue: str = ""
    pages: tuple[str, ...] = ()
    doi: str = ""
    arxiv: str = ""
    version: str = ""


def reference_line(work: Work) -> str:
    """Return a work as a line of a list of references."""
    names = []
    for family, given in work.authors:
        initials = " ".join(f"{name[0]}." for name in given.split())
        names.append(f"{family}, {initials}" if given else family)
    authors = f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]
    number = f"{work.volume}({work.issue})" if work.issue else work.volume
    source = [work.within, number, "-".join(work.pages), work.version and f"Version {work.version}"]
    parts = [
        f"{authors} ({work.year})" if work.year else authors,
        work.title,
        ", ".join(part for part in source if part),
        work.doi and f"doi:{work.doi}",
        work.arxiv and f"arXiv:{work.arxiv}",
    ]
    return " ".join(f"{part.rstrip('.')}." for part in parts if part)


def bibtex(work: Work) -> str:
    """Return a BibTeX entry in plain letters; names and titles keep their capitals by braces."""
    kind = {"article": "article", "conference-paper": "inproceedings"}.get(work.kind, "misc")
    fields = {
        "author": " and ".join(_bibtex_name(*author) for author in work.authors),
        "title": f"{{{_plain(work.title)}}}",
        {"article": "journal", "inproceedings": "booktitle"}.get(kind, "note"): work.within,
        "version": work.version,
        "year": work.year,
        "volume": work.volume,
        "number": work.issue,
        "pages": "--".join(work.pages),
        "doi": work.doi,
        "eprint": work.arxiv,
        "archiveprefix": "arXiv" if work.arxiv else "",
    }
    # `misc` of old styles prints no version, but a note.
    fields |= {"note": f"Version {work.version}"} if work.version else {}
    body = [f"  {name} = {{{value}}}," for name, value in fields.items() if value]
    return "\n".join([f"@{kind}{{{work.key},", *body, "}"])


def _bibtex_name(family: str, given: str) -> str:
    whole = f"{{{family}}}" if " " in family else family
    return _plain(f"{whole}, {given}" if given else whole)


def _plain(text: str) -> str:
    r"""Return a text with accented letters as TeX has them: `{\'a}`."""
    marks = {"\u0300": "`", "\u0301": "'", "\u0302": "^", "\u0303": "~", "\u0308": '"'}
    letters = []
    for letter in unicodedata.normalize("NFC", text):
        base, *mark = list(unicodedata.normalize("NFD", letter))
        letters.append(f"{{\\{marks[mark[0]]}{base}}}" if mark else letter)
    return "".join(letters)


def cff(work: Work) -> dict[str, Any]:
    """Return a work as a reference of the Citation File Format."""
    people = [
        {"family-names": family, "given-names": given} if given else {"name": family}
        for family, given in work.authors
    ]
    meeting = work.kind == "conference-paper"
    fields = {
        "type": work.kind,
        "title": work.title,
        "authors": people,
        "version": work.version,
        "year": int(work.year) if work.year else "",
        "conference": {"name": work.within} if meeting else "",
        "journal": "" if meeting else work.within,
        "volume": work.volume,
        "issue": work.issue,
        **dict(zip(("start", "end"), work.pages, strict=False)),
        "doi": work.doi,
        "identifiers": [{"type": "other", "value": f"arXiv:{work.arxiv}"}] if work.arxiv else "",
    }
    return {name: value for name, value in fields.items() if value}


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
    """How to cite a result; `sentence`, of a section on methods, names works by the keys of BibTeX."""

    sentence: str
    works: tuple[Work, ...]

    @property
    def text(self) -> str:
        """The sentence, and a list of references."""
        return "\n".join(
            [self.sentence, "", *(f"[{work.key}] {reference_line(work)}" for work in self.works)]
        )

    @property
    def bibtex(self) -> str:
        """The works as BibTeX entries."""
        return "\n\n".join(bibtex(work) for work in self.works)

    @property
    def cff(self) -> str:
        """The text of `CITATION.cff`, by the Citation File Format 1.2.0."""
        this, *others = self.works
        about = {
            "cff-version": "1.2.0",
            "message": "Please cite bayesdrill, and the works below that a result stands on.",
            "abstract": f"{ABOUT}.",
            "license": LICENCE,
            **({"date-released": RELEASED} if this.year else {}),
            **{name: value for name, value in cff(this).items() if name != "year"},
            "references": [cff(work) for work in others],
        }
        return _yaml(about)

    def __str__(self) -> str:
        return self.text


def citation(versions: Mapping[str, str] | None = None) -> Citation:
    """Return how to cite what a result was made with: these `versions`, or what is installed."""
    used = {**installed_versions(), **(versions or {})}
    number = used["bayesdrill"]
    # When another version was released is not known here.
    this = replace(
        BAYESDRILL, version=number, year=RELEASED[:4] * (number == bayesdrill.__version__)
    )
    sentence = (
        f"The posterior was computed with bayesdrill {number} [{this.key}], "
        f"on a model of the rig of [{PAPER.key}]. "
        f"It was sampled with emcee {used['emcee']} [{EMCEE.key}] "
        f"and diagnosed with ArviZ (arviz-stats {used['arviz-stats']}) [{ARVIZ.key}]."
    )
    return Citation(sentence, (this, PAPER, EMCEE, ARVIZ))


def _yaml(data: Mapping[str, Any]) -> str:
    from ruamel.yaml import YAML

    out, yaml = io.StringIO(), YAML()
    yaml.width = 100
    yaml.indent(mapping=2, sequence=4, offset=2)
    yaml.dump(dict(data), out)
    return out.getvalue()
