"""`bayesdrill design`: what it prints and writes, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from support.case_tables import run_cases
from support.command_line import REFUSALS, assert_refused, cli, listing, posterior, small_config

import bayesdrill as bd
from bayesdrill.report import style

NUMBERS = ("--high", "12", "--hold", "1", "--draws", "2")


def test_a_design_is_printed_and_written(tmp_path: Path) -> None:
    arrays = (("small.csv", "small.npz"), ("w_1: {column: w_1", "w_1: {variable: w_1"))
    config, out = small_config(tmp_path, *arrays), tmp_path / "next"
    table = np.genfromtxt(tmp_path / "small.csv", delimiter=",", names=True)
    np.savez(tmp_path / "small.npz", **{name: table[name] for name in table.dtype.names})
    command = ("design", config, "--learn", "k_e, j_1", *NUMBERS, "--limit", "w_2=0:", "-o", out)
    result = cli(*command)
    assert result.status == 0, result.text
    shown, head = (
        " ".join(result.out.split()),
        "now as recorded step prbs chirp multisine steps coast",
    )
    for text in (head, "2 draws of the prior", "k_e: from 31 % to", "keep the limits 0 <= w_2"):
        assert text in shown
    figures = {"figures", "figures/design.pdf", "figures/design.png"}
    assert {*listing(out)} == {"waveform.csv", "coming.yaml", "design.csv", "design.md"} | figures
    coming = yaml.safe_load((out / "coming.yaml").read_text())["record"]["channels"]
    assert coming["w_1"] == {"column": "w_1", "unit": "rad/s", "sigma": 0.05}
    waveform = np.genfromtxt(out / "waveform.csv", delimiter=",", names=True)
    assert waveform["t"][-1] == 5.0
    assert 0.0 <= waveform["v"].min() < waveform["v"].max() <= 12.0
    assert_refused(cli(*command), "exists already")
    quick = ("design", config, "--family", "step", "--hold", "0.5", "--draws", "1", "-o", out)
    assert cli(*quick, "--force").status == 0


@pytest.mark.slow
def test_a_run_ends_with_the_line_that_starts_a_design_with_its_posterior(tmp_path: Path) -> None:
    box = "{prior: uniform, low: 0.5, high: 1.5, relative: true}"
    config = small_config(tmp_path, ("c_m: nominal", f"c_m: {box}"))
    run = posterior(config, tmp_path / "run")
    line = f"bayesdrill design {tmp_path / 'run'} --learn 'c_m"
    assert ("Not determined" in run.out) == (line in run.out), run.out
    assert line in run.out
    known = cli("design", tmp_path / "run", *NUMBERS)
    assert known.status == 0, known.text
    assert "2 draws of the posterior" in known.out


def test_an_interrupted_save_leaves_no_half_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    designed = bd.load(small_config(tmp_path)).design("k_e", family="step", hold=0.5, draws=1)
    monkeypatch.setattr(style, "save", interrupt)
    for folder in (tmp_path / "new", tmp_path / "old"):
        if folder.name == "old":
            folder.mkdir()
            (folder / "notes.txt").write_text("mine")
        with pytest.raises(KeyboardInterrupt):
            designed.save(folder)
    assert not (tmp_path / "new").exists()
    assert {*listing(tmp_path / "old")} == {"notes.txt"}


@run_cases("options, words", REFUSALS["design"])
def test_mistakes_end_in_a_sentence_and_no_waveform(
    options: str, words: str, tmp_path: Path
) -> None:
    config, out = small_config(tmp_path), tmp_path / "next"
    assert_refused(cli("design", config, "--draws", "1", *options.split(), "-o", out), words)
    assert not out.exists()


@pytest.mark.slow
def test_a_parameter_below_the_noise_is_refused(tmp_path: Path) -> None:
    box = "{prior: uniform, low: 0.5, high: 1.5, relative: true}"
    config = small_config(tmp_path, ("c_m: nominal", f"c_m: {box}"))
    short = ("--duration", "0.5", "--hold", "0.1", "--learn", "c_m", "--draws", "1")
    assert_refused(cli("design", config, *short), "narrows nothing", "c_m to")


def test_what_no_waveform_shows_comes_with_what_would(tmp_path: Path) -> None:
    result = cli("design", "configs/nominal_step.yaml", "--learn", "k_s", "--draws", "1")
    assert_refused(
        result,
        "no waveform shows k_s",
        "weigh or measure j_1 to 1 %",
        "(to 1 %) added to j_1: this divides its sd by",
        "--learn: to learn k_s, apply a known load torque",
        "--learn: a waveform can determine: k_s/j_1",
        "r_m/l_m",
    )
