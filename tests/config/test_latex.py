"""Users may write in formulas what both LaTeX and mathtext take, alone and in products."""

import pytest
from matplotlib.mathtext import MathTextParser
from support.case_tables import run_cases

from bayesdrill.basics import symbols, units
from bayesdrill.basics.symbols import Symbol, product_latex
from bayesdrill.config import latex as config_latex

REFUSED = (
    "a&b", "a%b", "a#b", "a$b", "a~b", 'a"b', "\\", "a\\", "a\\\\b", "x_{", "x}", "a}{b", " ", "\n",
    r"x$ \input{/etc/passwd} $y", r"\input{/etc/passwd}", r"\write18{ls}", r"\text{\input}",
    r"\text{a&b}", "^^5cinput{x}", r"\csname input\endcsname", r"\mathdefault{x}", r"\quad",
    "\u03c9", "\x1b]0;x\x07", r"_\left(x\right)", r"\hat\sqrt{x}", "x^2'", "{" * 60 + "x" + "}" * 60,
)  # fmt: skip
TAKEN = (
    "x", "k_s", r"\omega_n", r"\dot\theta_1", r"\mathrm{ab}", r"x_{\mathrm{a\_b}}", r"\frac{a}{b}",
    r"d^2", "x'", r"x_\mathrm{max}", r"\Delta\,p", r"\sqrt{k_s/j_1}", r"\left(x\right)^{2}", r"\%",
)  # fmt: skip


def symbol(latex: str, unit: str = "") -> Symbol:
    return Symbol("q", "1", latex, unit, "")


@run_cases("latex", REFUSED)
def test_latex_that_would_leave_its_formula_is_refused(latex: str) -> None:
    with pytest.raises(ValueError, match="figures and tables cannot write") as caught:
        config_latex.check(symbol(latex))
    assert latex in str(caught.value)
    assert r"such as \omega_1" in str(caught.value)


@run_cases("latex", TAKEN)
def test_latex_can_stand_in_products_and_with_labels(latex: str) -> None:
    config_latex.check(symbol(latex))
    parse = MathTextParser("path").parse
    parse(f"${product_latex((2, -3), [symbol(latex), symbol(latex)])}$")
    parse(f"${symbols.superscript(latex, r'\mathrm{slow}')}$")


@run_cases("unit", ["\u00b0\u00b2", "\u00b0**2"])
def test_powers_of_signs_can_be_drawn(unit: str) -> None:
    config_latex.check(symbol("x", units.display_unit(unit).latex))
