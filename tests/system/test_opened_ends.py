"""What lies beyond ends of priors is sampled by the run, kept in its folder, and read from there."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import systems

from bayesdrill.output_files import OPENED
from bayesdrill.sampling import extended_priors

AT_NOMINAL = ("k_e: {prior: uniform, low: 0.5", "k_e: {prior: uniform, low: 1.0")


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs of a rig, by two seeds, whose prior of k_e begins at its nominal value."""
    place = tmp_path_factory.mktemp("rig")
    for name, seed in (("out", "seed: 7"), ("other", "seed: 8")):
        config = systems.small(place, AT_NOMINAL, ("seed: 7", seed), name=f"{name}.yaml")
        ran = systems.cli("posterior", config, "-o", place / name, "--processes", "1")
        assert ran.status == 0, ran.text
        assert "priors of k_e end near nominal values: once more" in ran.err
    return place


@pytest.fixture
def out(done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy, of which nothing is sampled."""

    def refused(*_: object) -> None:
        raise AssertionError("a posterior is sampled")

    monkeypatch.setattr(extended_priors, "sample", refused)
    shutil.copytree(done, tmp_path / "rig")
    return tmp_path / "rig" / "out"


def test_reports_and_verify_read_what_the_run_has_found(out: Path) -> None:
    """Mutant killed: it is sampled again."""
    before = systems.listing(out)
    ran = systems.cli("verify", out)
    assert ran.status == 0, ran.text
    assert systems.listing(out) == before
    ran = systems.cli("report", out, "--processes", "1")
    assert ran.status == 0, ran.text
    again = systems.listing(out)
    for name in (OPENED, "verdict.csv", "summary.csv"):
        assert again[name] == before[name]


def test_of_a_run_that_kept_nothing_nothing_is_said(out: Path) -> None:
    """As older versions have left it.  Mutant killed: a verdict from draws that end at the table."""
    (out / OPENED).unlink()
    ran = systems.cli("report", out, "--processes", "1")
    assert ran.status == 0, ran.text
    assert "note: The priors of k_e end near nominal values" in ran.out
    assert "At an end of its prior: k_e" in ran.out
    assert "For the tension they are taken as open" not in ran.out
    ran = systems.cli("verify", out)
    assert ran.status == 2
    assert f"{OPENED}: not there: a run of an older version" in ran.err
    assert "does not follow" not in ran.err


def test_what_is_not_of_this_chain_is_refused_and_made_again(
    out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mutant killed: draws of another run are believed."""
    whole = (out / OPENED).read_bytes()
    for wrong in ((out.parent / "other" / OPENED).read_bytes(), whole[:-40]):
        (out / OPENED).write_bytes(wrong)
        for command in ("report", "verify"):
            ran = systems.cli(command, out)
            assert ran.status == 2
            assert f"{OPENED}: is of another chain, or is damaged; delete it" in ran.err
    monkeypatch.undo()
    (out / OPENED).unlink()
    config = out.parent / "out.yaml"
    ran = systems.cli("posterior", config, "-o", out, "--resume", "--processes", "1")
    assert ran.status == 0, ran.text
    assert (out / OPENED).read_bytes() == whole
