"""What stands in the documents: blocks of code, files that they show, cells of notebooks, anchors."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.md"))
DOCUMENTS = [ROOT / "README.md", *sorted(DOCS.glob("*.md")), *NOTEBOOKS]

CODE_CELL = r"{code-cell} ipython3"
NAMED = re.compile(r"# (\w+\.\w+)\n")


def blocks(path: Path, language: str) -> list[str]:
    found = re.escape(language)
    return re.findall(rf"^```{found}\n(.*?)^```", path.read_text(), re.MULTILINE | re.DOTALL)


def commands(path: Path) -> list[str]:
    return [line for block in blocks(path, "sh") for line in block.splitlines()]


def files(path: Path) -> dict[str, str]:
    """Configs that begin with their own name, such as `# my_rig.yaml`."""
    named = [(NAMED.match(block), block) for block in blocks(path, "yaml")]
    return {match[1]: block for match, block in named if match}


def script(path: Path) -> str:
    """All that a page runs in Python: a page is one session."""
    return "\n".join(blocks(path, "python"))


def cells(path: Path) -> str:
    """Of a notebook, as a script: without options of cells and lines that only a notebook knows."""
    found = []
    for cell in blocks(path, CODE_CELL):
        plain = re.sub(r"\A---\n.*?^---\n", "", cell, flags=re.MULTILINE | re.DOTALL)
        lines = [line for line in plain.splitlines() if not re.match(r"%|:[\w-]+:", line)]
        found.append("\n".join(lines))
    return "\n".join(found)


def anchors(path: Path) -> set[str]:
    """As a forge and the site make them of headings."""
    text = re.sub(r"^```.*?^```", "", path.read_text(), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading) for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in plain}


FENCE = re.compile(r" *(```+|~~~)")
ITEM = re.compile(r"^ *(?:[-*]|\d+\.) +")
NO_PROSE = ("|", "#", "![", "<!--")  # tables, headings, figures, marks


def prose(path: Path) -> list[tuple[int, str]]:
    """Lines with their numbers; empty where there is code, a table, a heading or a figure, or what
    a tool writes."""
    lines = []
    fence, listed, code, blank = "", False, False, True
    written = r"\A---\n.*?^---\n|^<!-- (\w+) -->\n.*?^<!-- /\1 -->\n"
    text = re.sub(written, _blank_lines, path.read_text(), flags=re.M | re.S)
    for number, line in enumerate(text.splitlines(), 1):
        bare = line.strip()
        if match := FENCE.match(line):
            closed = fence and bare.startswith(fence)
            fence = "" if closed else fence or match[1]
            line = ""
        if bare and not line.startswith(" "):
            listed = bool(ITEM.match(line))
        code = line.startswith("    ") and not listed and (blank or code)
        blank = not bare
        lines.append((number, "" if fence or code or bare.startswith(NO_PROSE) else line))
    return lines


def _blank_lines(match: re.Match[str]) -> str:
    return "\n" * match[0].count("\n")


def sentences(path: Path) -> list[tuple[int, str]]:
    """Sentences of the prose, without marks of links, code and formulas, with the lines of their
    paragraphs."""
    paragraphs: list[tuple[int, list[str]]] = []
    ended = True
    for number, line in prose(path):
        if line.strip() and (ended or ITEM.match(line)):
            paragraphs.append((number, []))
        if line.strip():
            paragraphs[-1][1].append(ITEM.sub("", line).strip())
        ended = not line.strip()
    found = []
    for number, lines in paragraphs:
        text = re.sub(r"`[^`]+`|\$[^$]+\$", "X", " ".join(lines))
        text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
        text = re.sub(r"\b(al|cf|e\.g|i\.e|vs)\.", r"\1", text)
        split = re.split(r"(?<=[.!?])[)*\"]*\s+(?=[\"(*\[]*[A-Z0-9])", text)
        found += [(number, sentence) for sentence in split]
    return found
