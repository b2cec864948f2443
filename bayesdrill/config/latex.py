"""Check that matplotlib and LaTeX can typeset a user's symbol within its table cell."""

from __future__ import annotations

import re

from bayesdrill.basics.symbols import Symbol, superscript

MAX_BRACE_DEPTH = 8  # largest depth of nested braces

# Commands that matplotlib's mathtext and LaTeX both know. `table.tex` contains the text, so no
# command may read, write or define anything, or end the formula.
_ACCENTS = "hat|bar|dot|ddot|tilde|vec|check|breve|acute|grave|widehat|widetilde|overline"
_LETTERS = (
    "alpha|beta|gamma|delta|epsilon|zeta|eta|theta|iota|kappa|lambda|mu|nu|xi|pi|rho|sigma|tau|upsilon|"
    "phi|chi|psi|omega|varepsilon|vartheta|varpi|varrho|varsigma|varphi|"
    "Gamma|Delta|Theta|Lambda|Xi|Pi|Sigma|Upsilon|Phi|Psi|Omega|"
    "mathrm|mathit|mathbf|mathsf|mathtt|mathcal|"
    "infty|partial|nabla|ell|hbar|prime|circ|ast|star|bullet|perp|parallel"
)
_OTHERS = (
    "frac|sqrt|left|right|quad|qquad|langle|rangle|cdot|times|pm|mp|to|rightarrow|leftarrow|"
    "max|min|sin|cos|tan|exp|log|ln"
)
_KNOWN = re.compile(rf"{_ACCENTS}|{_LETTERS}|{_OTHERS}|[,:;! %#_{{}}]")
_COMMAND = re.compile(r"\\([A-Za-z]+|.?)", re.DOTALL)
_BARE = re.compile(  # an index or an accent whose argument LaTeX accepts only in braces
    rf"(?:[_^]|\\(?:{_ACCENTS})(?![A-Za-z]))"
    rf"(?! *(?:[{{A-Za-z0-9*+-]|\\(?:{_LETTERS})(?![A-Za-z])))"
)


def check(symbol: Symbol) -> None:
    """Raise `ValueError`, with a message for the user, if figures or tables cannot show the symbol."""
    from matplotlib.mathtext import MathTextParser  # imported late: loading takes half a second

    for text in (symbol.latex, rf"\mathrm{{{symbol.latex_unit}}}" if symbol.latex_unit else "1"):
        try:
            _check_latex(text)
            formulas = (text, superscript(text, "2"), f"{{{text}}}^{{2}}")  # alone and squared
            MathTextParser("path").parse(" ".join(f"${formula}$" for formula in formulas), 72)
        except Exception as error:  # the parser raises many kinds of exceptions
            reason = str(error).splitlines()[-1].partition(": ")[2] or str(error)
            raise ValueError(
                f"figures and tables cannot write '{text}' ({reason}); use what LaTeX and "
                r"matplotlib's mathtext both know, such as \omega_1 or \mathrm{ab}, in single quotes "
                "and without dollars"
            ) from None


def _check_latex(text: str) -> None:
    """Raise `ValueError` for text that would end its formula, its table cell or its line."""
    if not text.isprintable():
        raise ValueError("a character that cannot be printed")
    for name in _COMMAND.findall(text):
        if not _KNOWN.fullmatch(name):
            raise ValueError(rf"\{name} is not an allowed command")
    plain, depth = _COMMAND.sub(" ", text), 0
    for letter in plain:
        if not letter.isascii() or letter in '&%#$~"`':
            raise ValueError(f"{letter} cannot stand there")
        depth += (letter == "{") - (letter == "}")
        if not 0 <= depth <= MAX_BRACE_DEPTH:
            break
    if depth:
        raise ValueError("braces that do not match, or too many")
    if bare := _BARE.search(text.replace(r"\_", " ")):
        raise ValueError(f"what stands after {bare[0]} needs braces")
    if "'" in text.partition("^")[2]:  # LaTeX may read the prime as a second power
        raise ValueError("a ' after a ^")
