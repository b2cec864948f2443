"""Ties, quantities and derived formulas as a user meets them: what is refused, and a whole run."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray
from support import command_line
from support.case_tables import run_cases

EXAMPLE = command_line.ROOT / "configs" / "example_ties.yaml"

TIE = "k_T: {tie: k_e}"
K_S = "k_s: pi*G*d**4/(32*L)"
OMEGA = "{formula: sqrt(k_s/j_1), unit: rad/s}"
D = "{prior: normal, mean: 3.0, sd: 0.01, unit: mm}"

WRONG = [
    ("tie to nothing", TIE, "k_T: {tie: k_f}", "k_T", "'k_f' is no parameter", "did you mean"),
    ("tie with a prior", TIE, "k_T: {tie: k_e, prior: uniform}", "k_T", "a tied parameter", "remove"),
    ("misspelt tie", TIE, "k_T: {tied: k_e}", "k_T", "`prior:` is missing", "uniform"),
    ("tie to itself", TIE, "k_T: {tie: k_T}", "k_T", "k_T -> k_T", "give one of these a prior"),
    ("unknown name", K_S, "k_s: pi*G*D**4/(32*L)", "k_s", "'D' is not a known name", "did you mean d"),
    ("no formula", K_S, "k_s: pi*G*d**4/(32*L", "k_s", "is not a formula", "write for example"),
    ("hat", K_S, "k_s: pi*G*d^4/(32*L)", "k_s", "not d^4", "d**4"),
    ("negative", K_S, "k_s: G*d*L - 1e9", "k_s", "must be positive", "narrow the priors"),
    ("infinite", K_S, "k_s: exp(G*d*L)", "k_s", "is inf at 100 %", "mend the formula"),
    ("unused", K_S, "k_s: pi*G*d**4/32", "L: {", "quantities.L: no formula names it", "remove it"),
    ("no unit", D, "{prior: normal, mean: 3.0, sd: 0.01}", "d: {", "quantities.d.unit", "missing"),
    ("wrong unit", D, D.replace("mm", "mmm"), "d: {", "unit 'mmm' is not known", "mm, GPa"),
    ("relative", D, D.replace("unit", "relative: true, unit"), "d: {", "no nominal value", "own unit"),
    ("start outside", D, D.replace("unit", "start: -1, unit"), "d: {", "-1", "greater than 0"),
    ("negative quantity", "value: 2.4", "value: -2.4", "L: {", "-2.4 is not positive", "all"),
    ("taken name", "  L: {value", "  i: {value", "i: {value", "has a meaning of its own", "choose"),
    ("no name", "  L: {value", "  2L: {value", "2L: {value", "cannot be a name", "letters"),
    ("derived of nothing", OMEGA, "sqrt(k_s/j_2)", "omega_1: ", "'j_2' is not a", "did you mean"),
    ("derived unit", OMEGA, OMEGA.replace("rad/s", "rodd"), "omega_1: ", "'rodd' is not known", "mm"),
    ("corner of nothing", "corner: [k_e", "corner: [k_f", "corner", "neither unknown", "did you mean"),
    ("truth of nothing", "{G: 79.6", "{H: 79.6", "quantities: {H", "no such quantity", "known: G"),
]  # fmt: skip


def config(folder: Path, *changes: tuple[str, str]) -> Path:
    text = EXAMPLE.read_text().replace("records/", f"{EXAMPLE.parent}/records/")
    for old, new in changes:
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in the config"
        text = text.replace(old, new)
    (folder / "mine.yaml").write_text(text)
    return folder / "mine.yaml"


@run_cases(
    "old, new, at, says, way_out",
    [case[1:] for case in WRONG],
    ids=[case[0] for case in WRONG],
)
def test_a_mistake_is_named_with_its_place_and_a_way_out(
    old: str, new: str, at: str, says: str, way_out: str, tmp_path: Path
) -> None:
    path = config(tmp_path, (old, new))
    ran = command_line.cli("check", path)
    assert ran.status == 2
    assert "Traceback" not in ran.text
    assert says in ran.err
    assert way_out in ran.err
    lines = path.read_text().splitlines()
    named = {int(line.split(":")[1]) for line in ran.err.splitlines() if ".yaml:" in line}
    assert any(at in lines[number - 1] for number in named), ran.err


def test_a_circle_of_two_is_named_once(tmp_path: Path) -> None:
    path = config(tmp_path, (TIE, "k_T: k_s*2"), (K_S, "k_s: k_T*G*d*L"))
    ran = command_line.cli("check", path)
    assert ran.status == 2
    assert "depends on itself (k_T -> k_s -> k_T)" in ran.err
    assert len(ran.err.splitlines()) == 1


def test_check_says_what_is_tied() -> None:
    ran = command_line.cli("check", EXAMPLE)
    assert ran.status == 0
    assert "tied: k_T = k_e, k_s = pi * G * d ** 4 / (32 * L)" in ran.out


@pytest.mark.slow
def test_a_short_run_of_the_example(tmp_path: Path) -> None:
    """Converges, and every draw of what is derived follows from the draw of the unknowns."""
    path = config(
        tmp_path,
        ("sampler: {walkers: 64}", "sampler: {walkers: 32, n_tau: 10, ess: 400}"),
        ("output:", "map: {starts: 1}\noutput:\n  predictive_draws: 10"),
    )
    out = tmp_path / "out"
    ran = command_line.cli("posterior", path, "-o", out, "--processes", "1")
    assert ran.status == 0, ran.text
    assert json.loads((out / "run.json").read_text())["converged"]
    tree = xarray.open_datatree(out / "posterior.nc")
    draws, derived = tree["posterior"], tree["derived"]
    assert derived["omega_1"].dims == ("chain", "draw")
    assert derived["w_end"].attrs["units"] == "rad/s"
    assert np.array_equal(derived["k_T"], draws["k_e"])
    k_s = np.pi * draws["G"] * draws["d"] ** 4 / (32 * 2.4)
    assert np.allclose(derived["omega_1"], np.sqrt(k_s / draws["j_1"]), rtol=1e-12)
    truth = np.sqrt(np.pi * 79.6e9 * 3.005e-3**4 / (32 * 2.4) / 0.0284)
    spread = float(derived["omega_1"].std())
    assert abs(float(derived["omega_1"].mean()) - truth) < 4 * spread
    header, *rows = (out / "derived.csv").read_text().splitlines()
    assert header.startswith("name,unit,nominal,mean,sd,hdi94_low,hdi94_high")
    assert [row.split(",")[0] for row in rows][:2] == ["k_T", "k_s"]
    assert "| omega_1 | rad/s |" in (out / "summary.md").read_text()
    assert "agree with tables_2_3 (k_e, k_T, t_f as in the config)" in ran.text
