"""What `check`, `simulate` and a run say of records as they come."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from support import command_line
from support.case_tables import run_cases

LINES = command_line.small_record().splitlines()
CHANNEL = "w_1: {column: w_1, unit: rad/s, sigma: 0.05}"


def spiked(folder: Path, *rows: int) -> None:
    lines = list(LINES)
    for row in rows:
        lines[row - 1] = ",".join([*lines[row - 1].split(",")[:2], "900"])
    (folder / "small.csv").write_text("\n".join(lines) + "\n")


def test_check_lists_glitches_and_a_run_repeats_the_first(tmp_path: Path) -> None:
    rows = [30, 41, 52, 63, 74]
    loose = ("sigma: 0.05}\ninputs", "sigma: 500}\ninputs")
    config = command_line.small_config(tmp_path, loose, ("max_steps: 500", "max_steps: 100"))
    spiked(tmp_path, *rows)
    ran = command_line.cli("check", config)
    assert ran.status == 0, ran.text
    (line,) = [one for one in ran.out.splitlines() if one.startswith("record, glitches")]
    for row in rows:
        assert f"line {row} ({(row - 2) / 20:.6g} s)" in line
    ran = command_line.cli("posterior", config, "-o", tmp_path / "out", "--processes", "1")
    notes = json.loads((tmp_path / "out" / "run.json").read_text(encoding="utf-8"))["notes"]
    (note,) = [one for one in notes if "glitches" in one]
    assert "in 5 places (5 samples): line 30 (1.4 s)" in note
    assert "line 63" not in note
    assert "and 2 more" in note


def test_check_names_the_filter_of_a_decimated_record(tmp_path: Path) -> None:
    grid = ("duration: 5, rate: 20", "duration: 5, rate: 200")
    config = command_line.small_config(tmp_path, grid)
    ran = command_line.cli("simulate", config, "-o", tmp_path / "fast.csv")
    assert ran.status == 0, ran.text
    thin = ("file: small.csv", "file: fast.csv\n  decimate: {factor: 4}")
    ran = command_line.cli("check", command_line.small_config(tmp_path, thin))
    assert ran.status == 0, ran.text
    assert "a sample every 0.02 s (50 Hz), the first at 0.2 s" in ran.out
    assert "record: theta_1, w_1: filtered and decimated" in ran.out
    assert "one sample of 4 is left (231 of 1001)" in ran.out


@run_cases(
    "new, says",
    [
        (CHANNEL[:-1] + ", file: other.csv}", "a simulated record is one file with one time"),
        (CHANNEL[:-1] + ", time: {rate: 20}}", "a simulated record is one file with one time"),
        (CHANNEL[:-1] + ", derived_from: theta_1}", "has measured channels only"),
        (CHANNEL + "\n  decimate: {factor: 2}", "would be decimated again"),
    ],
)
def test_what_a_simulated_record_cannot_be(new: str, says: str, tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path, (CHANNEL, new))
    ran = command_line.cli("simulate", config, "-o", tmp_path / "made.csv")
    assert ran.status == 2
    assert says in ran.err
    assert not (tmp_path / "made.csv").exists()


def test_a_differenced_speed_is_suspected_and_then_declared(tmp_path: Path) -> None:
    t, angle, _ = np.array([line.split(",") for line in LINES[1:]], dtype=float).T
    speed = np.diff(angle, prepend=angle[0]) * 20.0
    rows = [f"{a:.9g},{b:.9g},{c:.9g}" for a, b, c in zip(t, angle, speed, strict=True)]
    config = command_line.small_config(tmp_path)
    (tmp_path / "small.csv").write_text("\n".join([LINES[0], *rows]) + "\n")
    said = command_line.cli("check", config).out
    assert "record, derived: the noise of w_1 is that of differences of theta_1" in said
    config = command_line.small_config(
        tmp_path, (CHANNEL, CHANNEL[:-1] + ", derived_from: theta_1}")
    )
    (tmp_path / "small.csv").write_text("\n".join([LINES[0], *rows]) + "\n")
    said = command_line.cli("check", config).out
    assert "record, derived" not in said
    assert "w_1 is not counted, as it is derived from theta_1" in said
    assert "101 samples of theta_1 over" in said
