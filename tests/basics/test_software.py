"""Citations are as their authors ask for; `citation.bib` and `CITATION.cff` hold the same works."""

import re

from ruamel.yaml import YAML
from support.command_line import ROOT, cli

import bayesdrill as bd

ENTRIES = {re.split(r"[{,]", entry)[1]: entry for entry in bd.citation().split("\n\n")}
CFF = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))


def fields(entry: str) -> dict[str, str]:
    """Return the fields of an entry of BibTeX, without outer braces."""
    pairs = re.findall(r"^\s*(\w+)\s*=\s*[{\"]?(.*?)[}\"]?,?$", entry, re.M)
    return {name.lower(): value.strip("{}") for name, value in pairs}


def test_any_bibtex_reads_the_entries() -> None:
    """ASCII, braces that close, a comma after each field; the command prints the same."""
    text = bd.citation()
    ran = cli("cite")
    assert (ran.status, ran.out.strip()) == (0, text.strip())
    assert text.isascii()
    assert r"Germ{\'a}n" in text
    assert "{Cunha Jr}, Americo" in text
    for entry in ENTRIES.values():
        assert entry.count("{") == entry.count("}")
        first, *body, last = entry.strip().splitlines()
        assert (first[0], last) == ("@", "}")
        assert all(re.fullmatch(r"  \w+ = \{.+\},", line) for line in body)


def test_both_files_cite_this_version_and_the_same_works() -> None:
    this, *others = (fields(entry) for entry in ENTRIES.values())
    assert CFF["version"] == this["version"] == bd.__version__
    assert this["note"] == f"Version {bd.__version__}"
    assert CFF["date-released"][:4] == this["year"]
    assert CFF["title"] == this["title"]
    for reference, entry in zip(CFF["references"], others, strict=True):
        assert reference["title"] == entry["title"]
        assert (str(reference["year"]), reference.get("doi")) == (entry["year"], entry.get("doi"))
        assert len(reference["authors"]) == entry["author"].count(" and ") + 1
