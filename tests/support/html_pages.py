"""Pages of reports as they are parsed."""

from html.parser import HTMLParser
from pathlib import Path

from bayesdrill.basics.symbols import Symbol
from bayesdrill.report.render import as_html
from bayesdrill.report.section import Section

ALONE = frozenset(("meta", "img", "rect", "line", "br"))  # elements without an end


class Page(HTMLParser):
    """Elements in their order; raises where they do not nest."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.found: list[tuple[str, dict[str, str]]] = []
        self.grids: list[list[list[str]]] = []
        self.text = ""
        self.feed(html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in ALONE:
            self.open.append(tag)
        if tag == "table":
            self.grids.append([])
        if tag == "tr":
            self.grids[-1].append([])
        if tag in ("td", "th"):
            self.grids[-1][-1].append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, {name: value or "" for name, value in attrs}))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if {"td", "th"} & set(self.open):
            self.grids[-1][-1][-1] += data.strip("\n")
        if not {"style", "script"} & set(self.open):
            self.text += data

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.found if name == tag]


def page(*said: Section, figures: Path = Path(), symbols: tuple[Symbol, ...] = ()) -> Page:
    return Page(as_html("a title", "a kind", said, figures, symbols))
