"""What is wrong with a built site: links and anchors that lead nowhere, and files of other hosts.

    python docs/check_site.py build/docs

Links to elsewhere may stand in a text (`<a href>`); what a browser loads by itself must be in the site.
Exit status 1, and a line for each, where there is something.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADS = {"src", "srcset", "data", "poster"}  # attributes that a browser follows by itself
STYLED = re.compile(r"(?:url\(|@import)\s*['\"]?\s*((?:https?:)?//[^'\")\s]+)")


@dataclass
class Page(HTMLParser):
    """Its anchors, where its links lead, and what it loads."""

    anchors: set[str] = field(default_factory=set)
    links: list[str] = field(default_factory=list)
    loads: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if not value:
                continue
            if name == "id" or (tag == "a" and name == "name"):
                self.anchors.add(value)
            elif name in LOADS or (tag == "link" and name == "href"):
                self.loads.append(value)
            elif tag == "a" and name == "href":
                self.links.append(value)
            elif name == "style":
                self.loads += STYLED.findall(value)


def read(path: Path) -> Page:
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def wrong(site: Path) -> Iterator[str]:
    pages = {path: read(path) for path in sorted(site.rglob("*.html"))}
    if site / "index.html" not in pages:
        yield f"{site}: no index.html"
    for path, page in pages.items():
        here = path.relative_to(site)
        for target in page.loads:
            if _elsewhere(target):
                yield f"{here}: loads {target}"
            elif (found := _place(path, target)) and not found.exists():
                yield f"{here}: {target} is not there"
        for target in page.links:
            if _elsewhere(target):
                continue
            found, anchor = _place(path, target) or path, unquote(urlsplit(target).fragment)
            if not found.exists():
                yield f"{here}: {target} leads nowhere"
            elif anchor and found in pages and anchor not in pages[found].anchors:
                yield f"{here}: {target} has no such anchor"
    for path in sorted(site.rglob("*.css")):
        for target in STYLED.findall(path.read_text(encoding="utf-8")):
            yield f"{path.relative_to(site)}: loads {target}"


def _elsewhere(target: str) -> bool:
    return target.startswith("//") or urlsplit(target).scheme in ("http", "https", "mailto")


def _place(page: Path, target: str) -> Path | None:
    """Of a file in the site; None for one that stands in the page itself."""
    parts = urlsplit(target)
    if parts.scheme or not parts.path:
        return None
    return (page.parent / unquote(parts.path)).resolve()


if __name__ == "__main__":
    found = list(wrong(Path(sys.argv[1]).resolve()))
    print("\n".join(found) or "all links lead somewhere, and nothing is loaded from elsewhere")
    sys.exit(bool(found))
