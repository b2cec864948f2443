"""Names of symbols as they are printed: `j_m` with its index, from its LaTeX."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from html.entities import name2codepoint

from markupsafe import Markup

from bayesdrill.basics.symbols import INPUTS, PARAMETERS, STATES, Symbol

_DOT, _ABOVE = r"\dot", Markup("&#775;")
_INDEXED = re.compile(r"\\?(?P<letter>[A-Za-z]+)(_(\{(?P<inside>.+)\}|(?P<index>[A-Za-z0-9])))?")

_WORD = r"(?<![\w\\.])({})(?![\w(])(?!\.\w)"
_POWER = re.compile(r"\^(-?\d+)")
_CODE = re.compile(r"`([^`]+)`")
_STRONG = re.compile(r"\*\*([^*]+)\*\*")
_EMPHASIS = re.compile(r"(?<![\w*)])\*([A-Za-z][^*]*)\*(?!\w)")


def printed(symbols: Iterable[Symbol] = ()) -> Mapping[str, Markup]:
    """Of the rig's symbols and of these, by name; without those that have no simple form."""
    known = (*PARAMETERS.values(), *STATES.values(), *INPUTS.values(), *symbols)
    found = {symbol.name: _letter(symbol.latex) for symbol in known}
    return {name: Markup("<var>{}</var>").format(html) for name, html in found.items() if html}


def _letter(latex: str) -> Markup:
    """Empty where it is more than a letter with an index."""
    dotted = latex.startswith(_DOT)
    found = _INDEXED.fullmatch(latex.removeprefix(_DOT).replace(r"\mathrm", ""))
    if found is None:
        return Markup()
    letter = found["letter"]
    greek = letter in name2codepoint
    if len(letter) > 1 and not greek:
        return Markup()
    inside = (found["inside"] or "").strip("{}")
    index = found["index"] or _letter(inside) or inside
    if index and "\\" in index:
        return Markup()
    base = Markup(f"&{letter};") if greek else letter
    low = Markup("<sub>{}</sub>").format(index) if index else ""
    return _joined((base, _ABOVE if dotted else "", low))


def _joined(parts: Iterable[str]) -> Markup:
    """The one place where text becomes HTML: what is not `Markup` is escaped."""
    return Markup().join(parts)


def _within(
    pattern: re.Pattern[str],
    text: str,
    inside: Callable[[str], str],
    outside: Callable[[str], str],
) -> Markup:
    """Of `text`, no HTML yet: `inside` of what the group of `pattern` finds, `outside` of the rest."""
    parts = enumerate(pattern.split(text))
    return _joined(inside(part) if k % 2 else outside(part) for k, part in parts)


class Typesetter:
    """Text as HTML: escaped, names as they are printed, `code`, **strong** and *emphasis*."""

    def __init__(self, names: Mapping[str, Markup]) -> None:
        self._names = names
        longest = sorted(names, key=len, reverse=True)
        self._pattern = re.compile(_WORD.format("|".join(map(re.escape, longest))))

    def plain(self, text: str) -> Markup:
        """Names and powers alone."""
        return _within(self._pattern, text, self._names.__getitem__, _powers)

    def prose(self, text: str) -> Markup:
        """Backticks keep what is inside as it is."""
        return _within(_CODE, text, Markup("<code>{}</code>").format, self._strong)

    def _strong(self, text: str) -> Markup:
        def strong(part: str) -> Markup:
            return Markup("<strong>{}</strong>").format(self._emphasis(part))

        return _within(_STRONG, text, strong, self._emphasis)

    def _emphasis(self, text: str) -> Markup:
        def slanted(part: str) -> Markup:
            return Markup("<em>{}</em>").format(self.plain(part))

        return _within(_EMPHASIS, text, slanted, self.plain)


def _powers(text: str) -> Markup:
    return _within(_POWER, text, Markup("<sup>{}</sup>").format, str)
