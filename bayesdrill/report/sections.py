"""A report as a list of sections with their data; a terminal and Markdown show the same list."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Sentences:
    """A line for each; lines that begin with blanks go on with the one before."""

    text: str


@dataclass(frozen=True, slots=True)
class Note:
    """How to read what stands beside it: for a page, not for a terminal."""

    text: str


@dataclass(frozen=True, slots=True)
class Plain:
    """Text whose columns are aligned already: for a page, not for a terminal."""

    text: str


@dataclass(frozen=True, slots=True)
class Table:
    """`left`: heads of columns that begin at the left; `brief`: what a terminal shows, or else all."""

    heads: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    left: frozenset[str]
    brief: tuple[str, ...] | None = None

    def only(self, heads: Sequence[str]) -> Table:
        """Those columns that there are, in this order."""
        kept = [self.heads.index(head) for head in heads if head in self.heads]
        lines = tuple(tuple(line[k] for k in kept) for line in self.lines)
        return Table(tuple(self.heads[k] for k in kept), lines, self.left)


Block = Sentences | Note | Plain | Table


@dataclass(frozen=True, slots=True)
class Section:
    """`title`: empty where it goes on; `brief`: whether a terminal shows it."""

    title: str
    blocks: tuple[Block, ...]
    brief: bool = True


def as_text(sections: Sequence[Section]) -> tuple[str, ...]:
    """Paragraphs for a terminal, where tables stand first: what is read there is the end."""
    shown = [section for section in sections if section.brief]
    return tuple(text for section in shown for text in _paragraphs(section))


def _paragraphs(section: Section) -> Iterator[str]:
    for block in section.blocks:
        if isinstance(block, Table):
            own = block if block.brief is None else block.only(block.brief)
            left = {k for k, head in enumerate(own.heads) if head in own.left}
            yield aligned([own.heads, *own.lines], left=left)
    yield from (block.text for block in section.blocks if isinstance(block, Sentences))


def as_markdown(title: str, sections: Sequence[Section]) -> str:
    """A page."""
    parts = [f"# {title}"]
    for section in sections:
        parts += [f"## {section.title}"] * bool(section.title)
        parts += [_in_markdown(block) for block in section.blocks]
    return "\n\n".join(parts) + "\n"


def _in_markdown(block: Block) -> str:
    match block:
        case Sentences(text):
            lines = text.splitlines()
            return "\n".join(f"- {line.strip().removeprefix('- ')}" for line in lines)
        case Table(heads, lines):
            return markdown(heads, lines).rstrip()
        case Plain(text):
            return f"```text\n{text}\n```"
        case Note(text):
            return text


def markdown(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A table in Markdown, its last line ended."""
    bar = "|" + " --- |" * len(heads)
    return "\n".join([_line(heads), bar, *map(_line, lines)]) + "\n"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


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
