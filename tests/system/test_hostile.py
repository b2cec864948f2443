"""Texts of users where they would be more than text: in pages, in a table for LaTeX, on a terminal."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from support import command_line, injection_payloads


class Elements(HTMLParser):
    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: set[str] = set()
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes |= {name for name, _ in attrs}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a maximum in `out`, whose places are hostile too."""
    place = tmp_path_factory.mktemp("hostile") / injection_payloads.RUNS
    done = command_line.cli(
        "map", injection_payloads.small(place), "-o", place / "out", "--processes", "1"
    )
    assert done.status == 0, done.text
    return place


def test_a_page_has_none_but_its_own_elements(folder: Path) -> None:
    """Mutants killed: the index of `latex:` as HTML; names of columns and files as they are."""
    html = (folder / "out" / "report.html").read_text(encoding="utf-8")
    found = Elements(html)
    assert found.tags.count("script") == 1
    assert found.tags.count("img") == 2  # the fit, and where it is enlarged
    assert not any(name.startswith("on") or name == "style" for name in found.attributes)
    assert html.count("owned=1") > 5
    assert not re.search("<[A-Za-z/!?]", (folder / "out" / "map.md").read_text(encoding="utf-8"))


def test_a_terminal_shows_columns_and_obeys_nothing(folder: Path) -> None:
    ran = command_line.cli("check", folder / "small.yaml")
    assert ran.status == 0, ran.text
    assert injection_payloads.COLUMNS["theta_1"] in ran.out
    missing = command_line.cli(
        "map", folder / "small.yaml", "-o", folder / f"{injection_payloads.OBEYED}/none"
    )
    for text in (ran.text, missing.text):
        assert text.replace("\n", "").isprintable()
