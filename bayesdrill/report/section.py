"""Build a report as a list of sections with their data.

Terminal, Markdown and HTML show the same list, and tables have the same rows for the terminal, for
CSV and for Markdown.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from bayesdrill.basics.errors import printable
from bayesdrill.inference.derived import HDI_PROBABILITY


def listed(names: Sequence[str], conjunction: str = " and ") -> str:
    """Join names with commas, and the last with a conjunction."""
    *first, last = names
    return f"{', '.join(first)}{conjunction}{last}" if first else last


_TAG = re.compile(r"<(?=[A-Za-z/!?])")


@dataclass(frozen=True, slots=True)
class Sentences:
    """The block is lines of text; lines that begin with blanks continue the one before."""

    text: str


@dataclass(frozen=True, slots=True)
class Item:
    """The item is a sentence, with `more` that continue it."""

    text: str
    more: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Note:
    """The note says how to read a page; a terminal does not show it."""

    text: str


@dataclass(frozen=True, slots=True)
class Plain:
    """The text has aligned columns already; a terminal does not show it.

    `folded`: under these words, where a page can fold it away.
    """

    text: str
    folded: str = ""


# Heads of columns that say in a word what is known, which a page colours.
WORDS = frozenset(("verdict", "the record says"))
Tone = Literal["good", "plain", "doubt", "bad"]


@dataclass(frozen=True, slots=True)
class Badge:
    """The badge says one property of a run at a glance."""

    text: str
    tone: Tone


@dataclass(frozen=True, slots=True)
class Badges:
    """The badges stand at the top of a page; a terminal does not show them."""

    items: tuple[Badge, ...]


@dataclass(frozen=True, slots=True)
class Picture:
    """The picture is a figure of the same folder, by the stem of its files.

    `says`: what is seen in it; `ending`: of the file for a page.
    """

    stem: str
    says: str
    ending: str = "png"


@dataclass(frozen=True, slots=True)
class IntervalBar:
    """The bar is an interval with two values, as fractions (0 to 1) of the range that is drawn."""

    low: float
    high: float
    nominal: float | None
    best: float


@dataclass(frozen=True, slots=True)
class Table:
    """The table has cells of text.

    `left`: heads of columns that begin at the left; `brief`: what a terminal shows, or else all;
    `bars`: of each line, where a page can draw them, or none at all.
    """

    heads: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    left: frozenset[str]
    brief: tuple[str, ...] | None = None
    bars: tuple[IntervalBar, ...] = ()

    def filled(self, *heads: str) -> Table:
        """Return the table without those of these columns, or of all, that are empty in every line."""
        needed = [any(cells) for cells in zip(*self.lines, strict=True)] or [True] * len(self.heads)
        return self._of(
            [k for k, head in enumerate(self.heads) if needed[k] or (heads and head not in heads)]
        )

    def only(self, heads: Sequence[str]) -> Table:
        """Return those of these columns that there are, in this order."""
        return self._of([self.heads.index(head) for head in heads if head in self.heads])

    def _of(self, columns: Sequence[int]) -> Table:
        lines = tuple(tuple(line[k] for k in columns) for line in self.lines)
        return replace(self, heads=tuple(self.heads[k] for k in columns), lines=lines)


def table_of(
    lines: Iterable[Mapping[str, str]], *left: str, brief: tuple[str, ...] | None = None
) -> Table:
    """Build a table of one or more lines, each with its cells by head; `left`, `brief`: see `Table`."""
    every = [*lines]
    cells = tuple(tuple(line.values()) for line in every)
    return Table(tuple(every[0]), cells, frozenset(left), brief)


Block = Sentences | Note | Plain | Badges | Picture | Table


@dataclass(frozen=True, slots=True)
class Section:
    """The section is a title and the blocks below it.

    `title`: empty where it goes on; `brief`: whether a terminal shows it.
    """

    title: str
    blocks: tuple[Block, ...]
    brief: bool = True


def build(title: str, *blocks: Block | str | None, brief: bool = True) -> Section:
    """Build a section of these blocks; text is `Sentences`, and what is empty is left out."""
    selected = [Sentences(block) if isinstance(block, str) else block for block in blocks if block]
    return Section(title, tuple(selected), brief)


def as_text(sections: Sequence[Section]) -> tuple[str, ...]:
    """Return paragraphs for a terminal; what a page begins with stands last, where it is read."""
    shown = [section for section in reversed(sections) if section.brief]
    return tuple(printable(text) for section in shown for text in _paragraphs(section))


def _paragraphs(section: Section) -> Iterator[str]:
    for table in (block for block in section.blocks if isinstance(block, Table)):
        shown = table if table.brief is None else table.only(table.brief)
        left = {k for k, head in enumerate(shown.heads) if head in shown.left}
        yield aligned([shown.heads, *shown.lines], left=left)
    yield from (block.text for block in section.blocks if isinstance(block, Sentences))


def as_markdown(title: str, sections: Sequence[Section]) -> str:
    """Return a page of Markdown."""
    parts = [_no_html(f"# {title}")]
    for section in sections:
        parts += [_no_html(f"## {section.title}")] * bool(section.title)
        parts += [_in_markdown(block) for block in section.blocks]
    return printable("\n\n".join(parts) + "\n")


def _no_html(text: str) -> str:
    """Replace what Markdown would take for an HTML tag; no text of a report means one."""
    return _TAG.sub("&lt;", text)


def _in_markdown(block: Block) -> str:
    match block:
        case Plain(text):
            fence = max(["``", *re.findall("`+", text)], key=len) + "`"
            return f"{fence}text\n{text}\n{fence}"
        case Sentences(text):
            bullets = (
                ["- " + item.text, *("  - " + more for more in item.more)] for item in items(text)
            )
            return _no_html("\n".join(itertools.chain(*bullets)))
        case Table():
            return _no_html(markdown(block).rstrip())
        case Note(text):
            return _no_html(text)
        case Badges(badges):
            return _no_html(", ".join(f"**{mark.text}**" for mark in badges))
        case Picture(stem, says, ending):
            picture = "" if ending == "pdf" else "!"  # pages cannot show a PDF
            return _no_html(f"{picture}[{says}](figures/{stem}.{ending})")


def items(text: str) -> list[Item]:
    """Split sentences: lines, where those that begin with blanks go on with the one before."""
    sentences: list[Item] = []
    for line in text.splitlines():
        sentence = line.strip().removeprefix("- ")
        if line.startswith(" ") and sentences:
            sentences[-1] = replace(sentences[-1], more=(*sentences[-1].more, sentence))
        else:
            sentences.append(Item(sentence))
    return sentences


def markdown(table: Table) -> str:
    """Return a table in Markdown, its last line ended."""
    bar = "|" + " --- |" * len(table.heads)
    return "\n".join([_line(table.heads), bar, *map(_line, table.lines)]) + "\n"


def _line(cells: Sequence[str]) -> str:
    one_line = (cell.replace("|", r"\|").replace("\n", " ") for cell in cells)
    return f"| {' | '.join(one_line)} |"


def aligned(table: Sequence[tuple[str, ...]], left: set[int]) -> str:
    """Return aligned columns for a wide terminal; those of `left` begin at the left."""
    widths = [max(len(line[k]) for line in table) for k in range(len(table[0]))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if k in left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in table
    )


CREDIBLE = f"{100 * HDI_PROBABILITY:.0f} %"
HDI = f"{CREDIBLE} HDI"
HDI_ENDS = tuple(f"hdi{100 * HDI_PROBABILITY:.0f}_{end}" for end in ("low", "high"))
# Of fields of records, the heads of their columns in files.
CSV_HEADS = {"hdi_low": HDI_ENDS[0], "hdi_high": HDI_ENDS[1], "word": "the_record_says"}


def records_as_csv(kind: type, rows: Sequence[object]) -> str:
    """Return CSV with a column for each field of `kind`: all digits, SI, and shares as fractions."""
    keys = [field.name for field in dataclasses.fields(kind)]
    heads = [CSV_HEADS.get(key, key) for key in keys]
    return lines_as_csv([heads, *([getattr(row, key) for key in keys] for row in rows)])


def lines_as_csv(lines: Iterable[Sequence[object]]) -> str:
    """Return CSV of lines; what is None is empty."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerows(["" if value is None else value for value in line] for line in lines)
    return out.getvalue()
