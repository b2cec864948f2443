"""Names of symbols as they are printed: `j_m` with its index, from its LaTeX."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from html.entities import name2codepoint

from markupsafe import Markup, escape

from bayesdrill.basics.symbols import INPUTS, PARAMETERS, STATES, Symbol

_DOT, _ABOVE = r"\dot", "&#775;"
_INDEXED = re.compile(r"\\?(?P<letter>[A-Za-z]+)(_(\{(?P<inside>.+)\}|(?P<index>[A-Za-z0-9])))?")

_WORD = r"(?<![\w\\.])(?:{})(?![\w(])(?!\.\w)"
_POWER = re.compile(r"\^(-?\d+)")
_CODE = re.compile(r"`([^`]+)`")
_STRONG = re.compile(r"\*\*([^*]+)\*\*")
_EMPHASIS = re.compile(r"(?<![\w*])\*([A-Za-z][^*]*)\*(?!\w)")


def printed(symbols: Iterable[Symbol] = ()) -> Mapping[str, Markup]:
    """Of the rig's symbols and of these, by name; without those that have no simple form."""
    known = (*PARAMETERS.values(), *STATES.values(), *INPUTS.values(), *symbols)
    found = {symbol.name: _letter(symbol.latex) for symbol in known}
    return {name: Markup(f"<var>{html}</var>") for name, html in found.items() if html}


def _letter(latex: str) -> str:
    """Empty where it is more than a letter with an index."""
    dotted = latex.startswith(_DOT)
    found = _INDEXED.fullmatch(latex.removeprefix(_DOT).replace(r"\mathrm", ""))
    if found is None:
        return ""
    letter = found["letter"]
    greek = letter in name2codepoint
    if len(letter) > 1 and not greek:
        return ""
    inside = (found["inside"] or "").strip("{}")
    index = found["index"] or _letter(inside) or inside
    if index and "\\" in index:
        return ""
    base = (f"&{letter};" if greek else letter) + (_ABOVE if dotted else "")
    return base + (f"<sub>{index}</sub>" if index else "")


class Typesetter:
    """Text as HTML: escaped, names as they are printed, `code`, **strong** and *emphasis*."""

    def __init__(self, names: Mapping[str, Markup]) -> None:
        self._names = names
        longest = sorted(names, key=len, reverse=True)
        self._pattern = re.compile(_WORD.format("|".join(map(re.escape, longest))))

    def plain(self, text: str) -> Markup:
        """Names and powers alone."""
        named = self._pattern.sub(lambda m: self._names[m[0]], str(escape(text)))
        return Markup(_POWER.sub(r"<sup>\1</sup>", named))

    def prose(self, text: str) -> Markup:
        """Backticks keep what is inside as it is."""
        parts = _CODE.split(text)
        html = [
            Markup("<code>{}</code>").format(part) if k % 2 else self._stressed(part)
            for k, part in enumerate(parts)
        ]
        return Markup("").join(html)

    def _stressed(self, text: str) -> Markup:
        html = _STRONG.sub(r"<strong>\1</strong>", str(self.plain(text)))
        return Markup(_EMPHASIS.sub(r"<em>\1</em>", html))
