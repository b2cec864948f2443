"""Figures on request, through a whole run: drawn by other processes, known to `verify` and `--force`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support import command_line

ON_REQUEST = ("rank", "autocorrelation", "predictive_check", "residuals")
ASKED = ("figures: []", f"figures: [{', '.join(ON_REQUEST)}]")


def drawn(out: Path) -> set[str]:
    return {path.name for path in (out / "figures").iterdir()}


@pytest.mark.slow
def test_a_finished_run_draws_what_a_resumed_config_asks_for(tmp_path: Path) -> None:
    out = tmp_path / "out"
    config = command_line.small_config(tmp_path)
    assert command_line.cli("posterior", config, "-o", out, "--processes", "1").status == 0
    assert drawn(out) == set()
    config = command_line.small_config(tmp_path, ASKED)
    ran = command_line.cli("posterior", config, "-o", out, "--resume", "--processes", "2")
    assert ran.status == 0, ran.text
    assert drawn(out) == {f"{name}.{end}" for name in ON_REQUEST for end in ("pdf", "png")}
    assert "belong together" in command_line.cli("verify", out).out
    (out / "figures" / "mine.png").write_text("mine")
    config = command_line.small_config(tmp_path)
    ran = command_line.cli("posterior", config, "-o", out, "--force", "--processes", "1")
    assert ran.status == 0, ran.text
    assert drawn(out) == {"mine.png"}


DRIVEN = (
    ("  v: 8.0", "  v: {column: v, unit: V}"),
    ("k_T: nominal", "k_T: 0.09"),
    (
        "theta_1, unit: rad, sigma: 0.05",
        "theta_1, unit: rad, sigma: {prior: uniform, low: 0, high: 9}",
    ),
    ("w_1, unit: rad/s, sigma: 0.05", "w_1, unit: rad/s, sigma: {prior: uniform, low: 0, high: 9}"),
    ("walkers: 8", "walkers: 16"),
)


@pytest.mark.slow
def test_a_fit_that_leaves_more_than_noise_shows_what_and_how_sure_it_is(tmp_path: Path) -> None:
    """With a motor that is not as strong as the one of the record; the same with noise enough shows no
    residuals.  Mutants killed: the figure of each run, or of none; sds of other units or unknowns.
    """
    config = command_line.small_config(tmp_path, *DRIVEN, ("figures: []", "figures: null"))
    lines = (tmp_path / "small.csv").read_text().splitlines()
    voltage = ["v", *(f"{6.0 + 2.0 * (k // 7 % 2)}" for k in range(len(lines) - 1))]
    (tmp_path / "small.csv").write_text(
        "".join(f"{line},{v}\n" for line, v in zip(lines, voltage, strict=True))
    )
    out = tmp_path / "out"
    ran = command_line.cli("posterior", config, "-o", out, "--processes", "1")
    assert ran.status == 3, ran.text
    assert {"residuals.pdf", "residuals.png"} <= drawn(out)
    assert "frequency_response.png" not in drawn(out)
    analysis = json.loads((out / "run.json").read_text())["analysis"]
    sds = {row["name"]: row["sd"] for row in analysis["unknowns"]}
    assert {*analysis["sandwich"]} == {*sds}
    assert "sd if residuals remember (sandwich)" in ran.out
    for name, sd in analysis["sandwich"].items():
        assert f"{sd / sds[name]:.3g}" in ran.out
    assert max(analysis["sandwich"][name] / sds[name] for name in sds) > 1.5
    assert "belong together" in command_line.cli("verify", out).out
