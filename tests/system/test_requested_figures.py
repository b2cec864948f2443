"""Figures on request, through a whole run: drawn by other processes, known to `verify` and `--force`."""

from __future__ import annotations

from pathlib import Path

import pytest
import systems

ON_REQUEST = ("rank", "autocorrelation", "predictive_check")
ASKED = ("figures: []", f"figures: [{', '.join(ON_REQUEST)}]")


def drawn(out: Path) -> set[str]:
    return {path.name for path in (out / "figures").iterdir()}


@pytest.mark.slow
def test_a_finished_run_draws_what_a_resumed_config_asks_for(tmp_path: Path) -> None:
    out = tmp_path / "out"
    config = systems.small(tmp_path)
    assert systems.cli("posterior", config, "-o", out, "--processes", "1").status == 0
    assert drawn(out) == set()
    config = systems.small(tmp_path, ASKED)
    ran = systems.cli("posterior", config, "-o", out, "--resume", "--processes", "2")
    assert ran.status == 0, ran.text
    assert drawn(out) == {f"{name}.{end}" for name in ON_REQUEST for end in ("pdf", "png")}
    assert "belong together" in systems.cli("verify", out).out
    (out / "figures" / "mine.png").write_text("mine")
    config = systems.small(tmp_path)
    ran = systems.cli("posterior", config, "-o", out, "--force", "--processes", "1")
    assert ran.status == 0, ran.text
    assert drawn(out) == {"mine.png"}
