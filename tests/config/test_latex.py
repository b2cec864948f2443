"""Users may write in formulas what both LaTeX and mathtext take, alone and in products."""

import random
import re
import shutil
import subprocess
from pathlib import Path

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


def _formula(rng: random.Random, depth: int = 0) -> str:
    """Return a formula of all that may stand in one, mostly in places where it may not."""
    words = f"{config_latex._ACCENTS}|{config_latex._LETTERS}|{config_latex._OTHERS}".split("|")
    kind = rng.random()
    if depth > 3 or kind < 0.5:
        return rng.choice([*(f"\\{word} " for word in words), *"abx01^__^'()[]|/+-=,.*@ <>!?:;"])
    inside = "".join(_formula(rng, depth + 1) for _ in range(rng.randint(0, 2)))
    if kind < 0.7:
        return f"{{{inside}}}"
    if kind < 0.85:
        return rng.choice("^_") + f"{{{inside}}}"
    return rng.choice([rf"\frac{{{inside}}}{{x}}", rf"\left({inside}\right]", rf"\dot{{{inside}}}"])


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="there is no pdflatex on PATH")
def test_latex_itself_takes_what_is_accepted(tmp_path: Path) -> None:
    """Each formula in a cell of its own."""
    rng, rows = random.Random(7), [*TAKEN]
    while len(rows) < 400:
        text = "".join(_formula(rng) for _ in range(rng.randint(1, 3)))
        try:
            config_latex.check(symbol(text))
        except ValueError:
            continue
        rows.append(text)
    tables = [
        rf"\begin{{tabular}}{{ll}}${row}$ & "
        rf"${symbols.superscript(row, 'a')}$ \\ \end{{tabular}}\newpage"
        for row in rows
    ]
    page = [r"\documentclass{article}\begin{document}", *tables, r"\end{document}", ""]
    (tmp_path / "rows.tex").write_text("\n".join(page))
    ran = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-file-line-error", "rows.tex"],
        cwd=tmp_path, capture_output=True, text=True, errors="replace", check=False,
    )  # fmt: skip
    assert re.findall(r"^(?:\./rows\.tex:|!).*", ran.stdout, re.MULTILINE) == []
