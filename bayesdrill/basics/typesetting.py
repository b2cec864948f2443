"""Whether figures will be able to write what a config wants them to."""

from __future__ import annotations

from bayesdrill.basics.symbols import Symbol


def check(symbol: Symbol) -> None:
    """Raises `ValueError` with a message for the user."""
    from matplotlib.mathtext import MathTextParser  # late: it takes half a second to load

    for text in (symbol.latex, rf"\mathrm{{{symbol.latex_unit}}}" if symbol.latex_unit else "1"):
        try:
            if not text.isprintable():
                raise ValueError("a character that cannot be printed")
            MathTextParser("path").parse(f"${text}$", 72)
        except Exception as error:  # a parser of formulas meets bad ones with many kinds
            why = str(error).splitlines()[-1].partition(": ")[2] or str(error)
            raise ValueError(
                f"figures cannot write '{text}' ({why}); use what matplotlib's mathtext knows, such "
                r"as \omega_1 or \mathrm{ab}, in single quotes and without dollars"
            ) from None
