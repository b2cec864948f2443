"""A report as a list of sections with their data: terminal, Markdown and HTML show the same list."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from bayesdrill.basics.errors import printable

_TAG = re.compile(r"<(?=[A-Za-z/!?])")


@dataclass(frozen=True, slots=True)
class Sentences:
    """A line for each; lines that begin with blanks go on with the one before."""

    text: str


@dataclass(frozen=True, slots=True)
class Item:
    """A sentence, and those that go on with it."""

    text: str
    more: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Note:
    """How to read what stands beside it: for a page, not for a terminal."""

    text: str


@dataclass(frozen=True, slots=True)
class Plain:
    """Text whose columns are aligned already: for a page, not for a terminal.

    `folded`: under these words, where a page can fold it away.
    """

    text: str
    folded: str = ""


# Heads of columns that say in a word what is known, which a page colours.
WORDS = frozenset(("verdict", "the record says"))

Tone = Literal["good", "plain", "doubt", "bad"]


@dataclass(frozen=True, slots=True)
class Mark:
    """Of a run, at a glance."""

    text: str
    tone: Tone


@dataclass(frozen=True, slots=True)
class Marks:
    """For a page, not for a terminal."""

    items: tuple[Mark, ...]


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure of the same folder, by the stem of its files; `says`: what is seen in it; `ending`: of
    the file for a page.
    """

    stem: str
    says: str
    ending: str = "png"


@dataclass(frozen=True, slots=True)
class Bar:
    """An interval and two values, as shares (0 to 1) of the range that is drawn."""

    low: float
    high: float
    nominal: float | None
    best: float


@dataclass(frozen=True, slots=True)
class Table:
    """`left`: heads of columns that begin at the left; `brief`: what a terminal shows, or else all;
    `bars`: of each line, where a page can draw them, or none at all.
    """

    heads: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    left: frozenset[str]
    brief: tuple[str, ...] | None = None
    bars: tuple[Bar, ...] = ()

    def filled(self, *heads: str) -> Table:
        """Without those of these columns, or of all, that are empty in every line."""
        kept = [
            k
            for k, head in enumerate(self.heads)
            if not self.lines
            or any(line[k] for line in self.lines)
            or (heads and head not in heads)
        ]
        lines = tuple(tuple(line[k] for k in kept) for line in self.lines)
        return replace(self, heads=tuple(self.heads[k] for k in kept), lines=lines)

    def only(self, heads: Sequence[str]) -> Table:
        """Those columns that there are, in this order."""
        kept = [self.heads.index(head) for head in heads if head in self.heads]
        lines = tuple(tuple(line[k] for k in kept) for line in self.lines)
        return replace(self, heads=tuple(self.heads[k] for k in kept), lines=lines)


Block = Sentences | Note | Plain | Marks | Picture | Table


@dataclass(frozen=True, slots=True)
class Section:
    """`title`: empty where it goes on; `brief`: whether a terminal shows it."""

    title: str
    blocks: tuple[Block, ...]
    brief: bool = True


def as_text(sections: Sequence[Section]) -> tuple[str, ...]:
    """Paragraphs for a terminal: what a page begins with stands last, where it is read."""
    shown = [section for section in reversed(sections) if section.brief]
    return tuple(printable(text) for section in shown for text in _paragraphs(section))


def _paragraphs(section: Section) -> Iterator[str]:
    for block in section.blocks:
        if isinstance(block, Table):
            own = block if block.brief is None else block.only(block.brief)
            left = {k for k, head in enumerate(own.heads) if head in own.left}
            yield aligned([own.heads, *own.lines], left=left)
    yield from (block.text for block in section.blocks if isinstance(block, Sentences))


def as_markdown(title: str, sections: Sequence[Section]) -> str:
    """A page."""
    parts = [_no_html(f"# {title}")]
    for section in sections:
        parts += [_no_html(f"## {section.title}")] * bool(section.title)
        parts += [_in_markdown(block) for block in section.blocks]
    return printable("\n\n".join(parts) + "\n")


def _no_html(text: str) -> str:
    """As it was written what a page of Markdown would take for a tag, which no text here means."""
    return _TAG.sub("&lt;", text)


def _in_markdown(block: Block) -> str:
    if isinstance(block, Plain):
        fence = max(["``", *re.findall("`+", block.text)], key=len) + "`"
        return f"{fence}text\n{block.text}\n{fence}"
    return _no_html(_text_in_markdown(block))


def _text_in_markdown(block: Sentences | Note | Marks | Picture | Table) -> str:
    match block:
        case Sentences(text):
            return "\n".join(_bullets(items(text)))
        case Table():
            return markdown(block).rstrip()
        case Note(text):
            return text
        case Marks(every):
            return ", ".join(f"**{mark.text}**" for mark in every)
        case Picture(stem, says, ending):
            picture = "" if ending == "pdf" else "!"  # which no page shows
            return f"{picture}[{says}](figures/{stem}.{ending})"


def items(text: str) -> list[Item]:
    """Of sentences: lines, where those that begin with blanks go on with the one before."""
    found: list[Item] = []
    for line in text.splitlines():
        own = line.strip().removeprefix("- ")
        if line.startswith(" ") and found:
            found[-1] = replace(found[-1], more=(*found[-1].more, own))
        else:
            found.append(Item(own))
    return found


def _bullets(found: Iterable[Item]) -> Iterator[str]:
    for item in found:
        yield f"- {item.text}"
        yield from (f"  - {more}" for more in item.more)


def markdown(table: Table) -> str:
    """Its last line ended."""
    bar = "|" + " --- |" * len(table.heads)
    return "\n".join([_line(table.heads), bar, *map(_line, table.lines)]) + "\n"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(map(_cell, cells)) + " |"


def _cell(text: str) -> str:
    """In one line, and in one column."""
    return text.replace("|", r"\|").replace("\n", " ")


def aligned(table: Sequence[tuple[str, ...]], left: set[int]) -> str:
    """Columns for a wide terminal; those of `left` begin at the left."""
    widths = [max(len(line[k]) for line in table) for k in range(len(table[0]))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if k in left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in table
    )
