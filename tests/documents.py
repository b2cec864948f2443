"""What stands in the documents: blocks of code, files that they show, cells of notebooks, anchors."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
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
