"""What users may write in formulas: no more than LaTeX and mathtext take, alone and in products."""

from __future__ import annotations

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


def named(latex: str, unit: str = "") -> Symbol:
    return Symbol("q", "1", latex, unit, "")


@run_cases("latex", REFUSED)
def test_what_would_leave_its_formula_is_refused_with_a_way_out(latex: str) -> None:
    """Mutant killed: mathtext alone asked, which takes `a&b`, and all that stands between dollars."""
    with pytest.raises(ValueError, match="figures and tables cannot write") as caught:
        config_latex.check(named(latex))
    assert latex in str(caught.value)
    assert r"such as \omega_1" in str(caught.value)


@run_cases("latex", TAKEN)
def test_what_is_taken_can_stand_in_products_and_with_labels(latex: str) -> None:
    """Mutant killed: a power after a power, at which mathtext raises while a figure is drawn."""
    config_latex.check(named(latex))
    parse = MathTextParser("path").parse
    parse(f"${product_latex((2, -3), [named(latex), named(latex)])}$")
    parse(f"${symbols.superscript(latex, r'\mathrm{slow}')}$")


@run_cases(
    "unit", ['m"\\input{x}"', r"m #\input{x}", "m'&'", "m\n", '%"<b>"', "m,s", "m\u00b2\u00b2"]
)
def test_a_unit_is_nothing_but_a_unit(unit: str) -> None:
    """Mutant killed: what pint reads past, comments and quotes, handed on to tables and figures."""
    with pytest.raises(ValueError, match="unit"):
        units.display_unit(unit)
    with pytest.raises(ValueError, match="unit"):
        units.factor(unit, "m")


@run_cases("unit", units._COMMON)
def test_common_units_are_what_pint_says_and_refused_as_it_refuses(unit: str) -> None:
    """A blank before a unit is nothing to pint, and no common unit."""
    for si in units._KINDS:
        try:
            value = units.factor(f" {unit}", si)
        except ValueError as error:
            message = str(error).replace(f"' {unit}'", f"'{unit}'")
            with pytest.raises(ValueError, match=re.escape(message)):
                units.factor(unit, si)
        else:
            assert units.factor(unit, si) == value


@run_cases("unit", ["\u00b0\u00b2", "\u00b0**2"])
def test_powers_of_signs_can_be_drawn(unit: str) -> None:
    config_latex.check(named("x", units.display_unit(unit).latex))


def _formula(rng: random.Random, depth: int = 0) -> str:
    """Of all that may stand in one, mostly in places where it may not."""
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
def test_latex_takes_what_is_taken(tmp_path: Path) -> None:
    """Oracle: LaTeX itself, where there is one; each formula in a cell of its own."""
    latex = shutil.which("pdflatex")
    if latex is None:
        pytest.skip("there is no pdflatex on PATH")
    rng, rows = random.Random(7), [*TAKEN]
    while len(rows) < 400:
        text = "".join(_formula(rng) for _ in range(rng.randint(1, 3)))
        try:
            config_latex.check(named(text))
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
    done = subprocess.run(
        [latex, "-interaction=nonstopmode", "-file-line-error", "rows.tex"],
        cwd=tmp_path, capture_output=True, text=True, errors="replace", check=False,
    )  # fmt: skip
    assert re.findall(r"^(?:\./rows\.tex:|!).*", done.stdout, re.MULTILINE) == []
