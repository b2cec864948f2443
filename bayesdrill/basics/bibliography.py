"""A work that can be cited, as a line of text, as an entry of BibTeX and as one of CFF."""

from __future__ import annotations

import unicodedata
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Work:
    """`kind`: a word of CFF; `authors`: (family, given), or (group, ""); `pages`: first, last."""

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


def line(work: Work) -> str:
    names = [f"{family}, {_initials(given)}" if given else family for family, given in work.authors]
    authors = f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]
    number = f"{work.volume}({work.issue})" if work.issue else work.volume
    place = [work.within, number, "-".join(work.pages), work.version and f"Version {work.version}"]
    parts = [
        f"{authors} ({work.year})" if work.year else authors,
        work.title,
        ", ".join(part for part in place if part),
        work.doi and f"doi:{work.doi}",
        work.arxiv and f"arXiv:{work.arxiv}",
    ]
    return " ".join(f"{part.rstrip('.')}." for part in parts if part)


def _initials(given: str) -> str:
    return " ".join(f"{name[0]}." for name in given.split())


def bibtex(work: Work) -> str:
    """In plain letters, for every BibTeX; names and titles keep their capitals by braces."""
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
    """An accented letter as TeX has it: `{\\'a}`."""
    marks = {"\u0300": "`", "\u0301": "'", "\u0302": "^", "\u0303": "~", "\u0308": '"'}
    found = []
    for letter in unicodedata.normalize("NFC", text):
        base, *mark = list(unicodedata.normalize("NFD", letter))
        found.append(f"{{\\{marks[mark[0]]}{base}}}" if mark else letter)
    return "".join(found)


def cff(work: Work) -> dict[str, Any]:
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
