"""Build a report as a list of sections with their data.

Terminal, Markdown and HTML are made from the same list, though a terminal omits some blocks. A
table has the same rows in these three formats and in CSV.
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
    """The block has one sentence per line; an indented line continues the line above it."""

    text: str


@dataclass(frozen=True, slots=True)
class Item:
    """The item is one sentence of a list; `details` are the sentences that are indented below it."""

    text: str
    details: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Note:
    """The note says how to read a page; a terminal does not show it."""

    text: str


@dataclass(frozen=True, slots=True)
class Plain:
    """The text has aligned columns already; a terminal does not show it.

    If `folded` is not empty, an HTML page collapses the text under this heading.
    """

    text: str
    folded: str = ""


# Heads of columns whose cells judge a quantity by one word. A page colours these cells.
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
class Link:
    """The link is a point of a picture, at fractions of width and height from its upper left.

    `label` is shown above the point, which is a link to `url` if there is one.
    """

    x: float
    y: float
    label: str
    url: str = ""


@dataclass(frozen=True, slots=True)
class Picture:
    """The picture refers to a figure of the run by the `stem` of its files.

    `extension` is the type of the file that a page shows, and `links` are points on the picture.
    """

    stem: str
    caption: str
    extension: str = "png"
    links: tuple[Link, ...] = ()


@dataclass(frozen=True, slots=True)
class IntervalBar:
    """The bar is an interval with two marked values, as fractions (0 to 1) of the drawn range."""

    low: float
    high: float
    nominal: float | None
    map: float


@dataclass(frozen=True, slots=True)
class Table:
    """The table has cells of text.

    `left_aligned` has the heads of left-aligned columns, and `brief` those that a terminal shows
    (None: all). `bars` has an interval for each line, which a page draws, or is empty.
    """

    heads: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    left_aligned: frozenset[str]
    brief: tuple[str, ...] | None = None
    bars: tuple[IntervalBar, ...] = ()

    def filled(self, *heads: str) -> Table:
        """Return the table without empty columns; if `heads` are given, only these may be removed."""
        needed = [any(cells) for cells in zip(*self.lines, strict=True)] or [True] * len(self.heads)
        return self._of(
            [k for k, head in enumerate(self.heads) if needed[k] or (heads and head not in heads)]
        )

    def only(self, heads: Sequence[str]) -> Table:
        """Return the table with only these columns, in this order; unknown heads are ignored."""
        return self._of([self.heads.index(head) for head in heads if head in self.heads])

    def _of(self, columns: Sequence[int]) -> Table:
        lines = tuple(tuple(line[k] for k in columns) for line in self.lines)
        return replace(self, heads=tuple(self.heads[k] for k in columns), lines=lines)


def table_of(
    lines: Iterable[Mapping[str, str]], *left_aligned: str, brief: tuple[str, ...] | None = None
) -> Table:
    """Build a table of one or more lines, which map heads to cells.

    `Table` explains `left_aligned` and `brief`.
    """
    every = [*lines]
    cells = tuple(tuple(line.values()) for line in every)
    return Table(tuple(every[0]), cells, frozenset(left_aligned), brief)


Block = Sentences | Note | Plain | Badges | Picture | Table


@dataclass(frozen=True, slots=True)
class Section:
    """The section is a title and the blocks below it.

    A section with an empty `title` continues the previous one. A terminal shows `brief` sections only.
    """

    title: str
    blocks: tuple[Block, ...]
    brief: bool = True


def build(title: str, *blocks: Block | str | None, brief: bool = True) -> Section:
    """Build a section of these blocks; strings become `Sentences`, and empty blocks are dropped."""
    selected = [Sentences(block) if isinstance(block, str) else block for block in blocks if block]
    return Section(title, tuple(selected), brief)


def as_text(sections: Sequence[Section]) -> tuple[str, ...]:
    """Return paragraphs for a terminal, the first section at the bottom, where a reader looks first."""
    shown = [section for section in reversed(sections) if section.brief]
    return tuple(printable(text) for section in shown for text in _paragraphs(section))


def _paragraphs(section: Section) -> Iterator[str]:
    for table in (block for block in section.blocks if isinstance(block, Table)):
        shown = table if table.brief is None else table.only(table.brief)
        left = {k for k, head in enumerate(shown.heads) if head in shown.left_aligned}
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
    """Escape what Markdown would read as an HTML tag, because texts of a report contain no HTML."""
    return _TAG.sub("&lt;", text)


def _in_markdown(block: Block) -> str:
    match block:
        case Plain(text):
            fence = max(["``", *re.findall("`+", text)], key=len) + "`"
            return f"{fence}text\n{text}\n{fence}"
        case Sentences(text):
            bullets = (
                ["- " + item.text, *("  - " + more for more in item.details)]
                for item in items(text)
            )
            return _no_html("\n".join(itertools.chain(*bullets)))
        case Table():
            return _no_html(markdown(block).rstrip())
        case Note(text):
            return _no_html(text)
        case Badges(badges):
            return _no_html(", ".join(f"**{mark.text}**" for mark in badges))
        case Picture(stem, says, ending, _):
            picture = "" if ending == "pdf" else "!"  # pages cannot show a PDF
            return _no_html(f"{picture}[{says}](figures/{stem}.{ending})")


def items(text: str) -> list[Item]:
    """Split text into items, one for each line; an indented line is added to the item above it."""
    sentences: list[Item] = []
    for line in text.splitlines():
        sentence = line.strip().removeprefix("- ")
        if line.startswith(" ") and sentences:
            sentences[-1] = replace(sentences[-1], details=(*sentences[-1].details, sentence))
        else:
            sentences.append(Item(sentence))
    return sentences


def markdown(table: Table) -> str:
    """Return a table in Markdown, with a line break at its end."""
    bar = "|" + " --- |" * len(table.heads)
    return "\n".join([_line(table.heads), bar, *map(_line, table.lines)]) + "\n"


def _line(cells: Sequence[str]) -> str:
    one_line = (cell.replace("|", r"\|").replace("\n", " ") for cell in cells)
    return f"| {' | '.join(one_line)} |"


def aligned(table: Sequence[tuple[str, ...]], left: set[int]) -> str:
    """Return a table with aligned columns for a wide terminal; columns `left` are left-aligned."""
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
# Heads of CSV columns that are not named like the field that they contain.
CSV_HEADS = {"hdi_low": HDI_ENDS[0], "hdi_high": HDI_ENDS[1], "word": "the_record_says"}


def records_as_csv(kind: type, rows: Sequence[object]) -> str:
    """Return CSV with a column for each field of `kind`, in full precision.

    Units are SI, and shares are fractions.
    """
    keys = [field.name for field in dataclasses.fields(kind)]
    heads = [CSV_HEADS.get(key, key) for key in keys]
    return lines_as_csv([heads, *([getattr(row, key) for key in keys] for row in rows)])


def mappings_as_csv(rows: Sequence[Mapping[str, object]]) -> str:
    """Return CSV of one or more rows, which map heads to cells; None becomes an empty cell."""
    return lines_as_csv([[*rows[0]], *([*row.values()] for row in rows)])


def lines_as_csv(lines: Iterable[Sequence[object]]) -> str:
    """Return CSV of lines; None becomes an empty cell."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerows(["" if value is None else value for value in line] for line in lines)
    return out.getvalue()
