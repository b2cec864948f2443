"""What is cited is as its authors say; every form of it holds the same."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import arviz_base
import emcee
from ruamel.yaml import YAML
from together import for_each

import bayesdrill
from bayesdrill.basics.software import ARVIZ, BAYESDRILL, EMCEE, PAPER, Work, citation

ROOT = Path(__file__).parents[2]


def fields(entry: str) -> dict[str, str]:
    """Of one entry of BibTeX, without its outer braces."""
    found = re.findall(r"^\s*(\w+)\s*=\s*[{\"]?(.*?)[}\"]?,?$", entry, re.M)
    return {name.lower(): value.strip("{}") for name, value in found}


def test_libraries_are_cited_as_they_ask_for() -> None:
    cases = {
        "emcee": (EMCEE, emcee.__bibtex__),
        "arviz": (ARVIZ, arviz_base.citations().split("@article")[1].split("\n\n")[0]),
    }

    def check(work: Work, entry: str) -> None:
        theirs = fields(entry)
        assert work.doi == theirs["doi"]
        assert work.title == theirs["title"]
        assert (work.year, work.volume) == (theirs["year"], theirs["volume"])
        assert "-".join(work.pages) == theirs["pages"]
        assert work.issue == theirs.get("number", "")
        assert work.arxiv == theirs.get("eprint", "")
        for family, _ in work.authors:
            assert family in theirs["author"]
        assert theirs["author"].count(" and ") == len(work.authors) - 1

    for_each(cases, check)


def test_the_paper_is_cited_as_its_page_names_it() -> None:
    page = " ".join((ROOT / "docs" / "paper.md").read_text().split())
    assert PAPER.title in page
    assert f"{PAPER.within}, arXiv {PAPER.arxiv}" in page
    assert not PAPER.doi  # none is known


def test_every_work_of_the_sentence_has_its_entry_and_no_other() -> None:
    said = citation()
    keys = re.findall(r"\[([\w]+)\]", said.sentence)
    assert keys == [work.key for work in said.works]
    assert re.findall(r"^@\w+\{(\w+),$", said.bibtex, re.M) == keys
    assert re.findall(r"^\[(\w+)\]", said.text, re.M) == keys
    assert str(said) == said.text


def test_entries_are_plain_and_whole() -> None:
    """Any BibTeX reads them: ASCII, braces that close, a comma after each field."""
    text = citation().bibtex
    assert text.isascii()
    assert r"Germ{\'a}n" in text
    assert "{Cunha Jr}, Americo" in text
    for entry in text.split("\n\n"):
        assert entry.count("{") == entry.count("}")
        first, *body, last = entry.splitlines()
        assert (first[0], last) == ("@", "}")
        assert all(re.fullmatch(r"  \w+ = \{.+\},", line) for line in body)


def test_a_run_is_cited_with_the_versions_that_made_it() -> None:
    old = citation({"bayesdrill": "0.0.9", "emcee": "3.0.0", "arviz-stats": "1.0.0"})
    assert "bayesdrill 0.0.9 " in old.sentence
    assert "emcee 3.0.0 " in old.sentence
    assert "arviz-stats 1.0.0)" in old.sentence
    assert not old.works[0].year  # of another version no date is known
    assert "date-released" not in old.cff
    now = citation()
    assert f"Version {bayesdrill.__version__}." in now.text
    assert now.works[0].year == BAYESDRILL.year


def test_the_file_of_the_checkout_is_up_to_date() -> None:
    """`make citation` writes it."""
    assert (ROOT / "CITATION.cff").read_text(encoding="utf-8") == citation().cff


def test_the_file_has_what_its_format_requires() -> None:
    """CFF 1.2.0: its keys, words and forms of values."""
    data = YAML(typ="safe").load(citation().cff)
    assert {"cff-version", "message", "title", "authors"} <= set(data)
    assert (data["cff-version"], data["type"]) == ("1.2.0", "software")
    assert data["version"] == bayesdrill.__version__
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", data["date-released"])
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert (data["license"], data["authors"]) == (project["license"], project["authors"])
    assert data["abstract"].rstrip(".") == project["description"]
    for reference in data["references"]:
        assert {"type", "title", "authors"} <= set(reference)
        assert reference["type"] in ("article", "conference-paper")
        assert re.fullmatch(r"10\.\d{4,9}/\S+", reference.get("doi", "10.1000/none"))
        assert all({"family-names"} < set(one) for one in reference["authors"])
