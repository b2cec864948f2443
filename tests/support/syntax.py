"""The syntax of source files, which is parsed once for all contracts of the code."""

import ast
from functools import cache
from pathlib import Path


@cache
def nodes(path: Path) -> list[ast.AST]:
    """Return all nodes of a file, outer ones first; the first is its module."""
    return list(ast.walk(ast.parse(path.read_text())))
