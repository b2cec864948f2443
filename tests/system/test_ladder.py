"""`bayesdrill ladder CONFIG`: rungs that are runs, a comparison, and a config to go on with."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import systems
from together import together

from bayesdrill import output_files, selection
from bayesdrill.basics.errors import Interrupted
from bayesdrill.basics.progress import Silent
from bayesdrill.config import loading
from bayesdrill.config.job import prepare
from bayesdrill.output_files import dumps_checksummed, loads_checksummed
from bayesdrill.selection import Ladder, Rung
from bayesdrill.tasks import ladder, remote

CONFIG = """\
name: turned
seed: 7
record:
  file: turned.csv
  time: {column: t, unit: s}
  channels:
    w_2: {column: w_2, unit: rad/s, sigma: {prior: log_uniform, low: 0.01, high: 10}}
inputs:
  t_m: {column: t_m, unit: N*m, hold: zero}
model: {name: motor}
parameters:
  j_m: {prior: uniform, low: 1.0e-4, high: 1.0e-3}
  c_m: {prior: uniform, low: 1.0e-4, high: 1.0e-2}
map: {starts: 1, evaluations: 500}
sampler: {walkers: 16, r_hat: 1.05, ess: 200, n_tau: 5}
output: {predictive_draws: 10, figures: []}
"""
J_M, C_M, FRICTION, SIGMA = 4e-4, 1e-3, 0.02, 0.1
DT, N, FINER = 0.02, 150, 400


def turned() -> str:
    """A motor with dry friction, turned to and fro by a torque: by as many short steps of Euler."""
    t = DT * np.arange(N)
    torque = 0.06 * np.sign(np.sin(4.0 * t + 0.3)) + 0.02
    w, speed = 0.0, []
    for push in torque:
        speed.append(w)
        for _ in range(FINER):
            free = w + DT / FINER * (push - C_M * w) / J_M
            most = DT / FINER * FRICTION / J_M
            w = free - min(max(free, -most), most)
    measured = np.array(speed) + SIGMA * np.random.default_rng(5).standard_normal(N)
    rows = zip(t, torque, measured, strict=True)
    return "t,t_m,w_2\n" + "".join(f"{a:.6g},{b:.6g},{c:.6g}\n" for a, b, c in rows)


@dataclass
class Stopping:
    """A reporter by which Ctrl-C comes when so many rungs are done."""

    rungs: int
    said: list[str] = field(default_factory=list)

    def say(self, text: str) -> None:
        self.said.append(text)

    def update(self, fraction: float, text: str) -> None:
        if text.startswith(f"{self.rungs} ") and fraction < 1:
            raise KeyboardInterrupt


def here(config: Path, folder: Path, how: str = "fresh", report: object = None) -> object:
    """A ladder in this process."""
    with remote.RefitExecutor(ThreadPoolExecutor(1)) as crew:
        try:
            return ladder.ladder(prepare(config), folder, how, crew, report or Silent())  # type: ignore[arg-type]
        finally:
            crew.shutdown(cancel_futures=True)


@dataclass(frozen=True)
class Done:
    config: Path
    folder: Path

    @property
    def run(self) -> dict[str, object]:
        return dict(json.loads((self.folder / "run.json").read_text()))


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Done:
    """Of a motor that rubs, fitted with one that does not; once stopped on its way."""
    place = tmp_path_factory.mktemp("ladder")
    given = place / "given.yaml"
    given.write_text(CONFIG)
    (place / "turned.csv").write_text(turned())
    with pytest.raises(Interrupted, match="continue with --resume"):
        here(given, place / "out", report=Stopping(2))
    assert json.loads((place / "out" / "run.json").read_text())["status"] == "interrupted"
    before = {p: p.stat().st_mtime_ns for p in (place / "out").glob("*/chain.h5")}
    assert len(before) == 2
    told = Stopping(-1)
    here(given, place / "out", "resume", told)
    assert "(2 of them done before)" in told.said[0]
    assert all(path.stat().st_mtime_ns == time for path, time in before.items())
    return Done(given, place / "out")


@dataclass(frozen=True)
class Told:
    log_z: float
    like_noise: bool


WORTH = {"friction_motor": 50.0, "friction_both": 100.0, "voltage_drop": 40.0, "ar1": 30.0}


class Guessing(ladder._Climb):
    """Nothing is sampled: each part is worth so much, damping beside friction alone; `enough` is all."""

    enough = 150.0

    def _run(self, wanted: Sequence[Rung]) -> None:
        for one in wanted:
            found = sum(WORTH.get(part, 0.0) for part in one.parts)
            if {"friction_both", "damping_shaft"} <= {*one.parts}:
                found += 30.0
            if "voltage_drop" in one.parts and len(one.parts) > 1:
                found -= 45.0
            self.done[one.name] = one, Told(found, found >= self.enough)  # type: ignore[assignment]


@together("enough, rounds", [(150.0, 2), (120.0, 1), (1000.0, 3)])
def test_as_long_as_more_than_noise_is_left_the_ladder_goes_on(
    enough: float, rounds: int, tmp_path: Path
) -> None:
    """Mutants killed: a ladder that ends with pairs; one that goes on where only noise is left."""
    job = prepare(systems.small(tmp_path, ("walkers: 8", "walkers: 24")))
    climb = Guessing(job, tmp_path, None, Silent(), again=False)  # type: ignore[arg-type]
    climb.enough = enough
    climb.up(Ladder.of(job))
    most = max(len(rung.parts) for rung, _ in climb.done.values())
    best = max(climb.done.values(), key=lambda pair: pair[1].log_z)[0]
    assert most == rounds + 1
    wanted = "friction_both-ar1" if rounds == 1 else "friction_both-damping_shaft-ar1"
    assert best.name == wanted
    assert set(climb.done) <= set(selection.rung_names())


@pytest.mark.slow
def test_what_is_missing_is_named_and_recommended(done: Done, tmp_path: Path) -> None:
    run = done.run
    assert run["status"] == "finished"
    assert (run["verdict"], run["recommended"]) == ("model", "friction_motor")
    page = (done.folder / "comparison.md").read_text(encoding="utf-8")
    assert "# Ladder of turned" in page
    assert "verdict: MODEL: friction_motor is e^" in page
    assert "what friction_motor leaves looks like the noise" in page
    recommended = done.folder / "recommended.yaml"
    checked = systems.cli("check", recommended)
    assert checked.status == 0, checked.text
    config = loading.load(recommended).config
    assert config.name == "turned_friction_motor"
    assert config.parameters["t_cm"] is not None


def test_a_rung_is_the_run_of_its_config(done: Done, tmp_path: Path) -> None:
    """Byte for byte; and a run of its own, that can be reported and compared again.

    Mutant killed: another stream for the search or the chain.
    """
    alone = tmp_path / "alone"
    systems.cli("posterior", done.config, "-o", alone, "--processes", "1")
    mine = done.folder / "as_given"
    for name in ("summary.csv", "map.json"):
        assert (mine / name).read_bytes() == (alone / name).read_bytes(), name
    both = [json.loads((place / "run.json").read_text())["log_evidence"] for place in (mine, alone)]
    assert both[0] == both[1]
    said = json.loads((done.folder / "run.json").read_text())["log_evidence"]
    assert said["as_given"] == both[0]
    ran = systems.cli("compare", mine, done.folder / "friction_motor", "-o", tmp_path / "two")
    assert "verdict: MODEL" in ran.out


def test_rungs_and_what_is_said_of_them_are_verified(done: Done, tmp_path: Path) -> None:
    """A rung's table, and the comparison, each forged with pains."""
    assert systems.cli("verify", done.folder).status == 0
    for k, place in enumerate(("as_given/summary.csv", "comparison.csv")):
        copy = tmp_path / str(k)
        shutil.copytree(done.config.parent, copy)
        table = copy / "out" / place
        lines = table.read_text().splitlines()
        table.write_text("\n".join([lines[0], lines[2], lines[1], *lines[3:]]) + "\n")
        run = loads_checksummed((table.parent / "run.json").read_bytes())
        run["files"][table.name] = output_files.digest(table)
        (table.parent / "run.json").write_text(dumps_checksummed(run))
        found = systems.cli("verify", copy / "out")
        assert found.status == 2
        assert f"{table}: does not follow from the chain" in found.err, found.err
        assert found.err.count("\n") == 1, found.err


def test_nothing_is_overwritten_unasked(done: Done, tmp_path: Path) -> None:
    shutil.copytree(done.config.parent, tmp_path / "copy")
    config, folder = tmp_path / "copy" / "given.yaml", tmp_path / "copy" / "out"
    before = systems.listing(tmp_path)
    for options, says in (
        ((), "results exist already; continue them with --resume"),
        (("--resume", "--force"), "--resume"),
    ):
        ran = systems.cli("ladder", config, "-o", folder, "--processes", "1", *options)
        assert ran.status == 2, options
        assert says in ran.err, ran.err
    changed = config.read_text().replace("seed: 7", "seed: 8")
    config.write_text(changed)
    ran = systems.cli("ladder", config, "-o", folder, "--processes", "1", "--resume")
    assert ran.status == 2
    assert "cannot resume: the seed was 7 and is 8" in ran.err
    config.write_text(changed.replace("seed: 8", "seed: 7"))
    assert systems.listing(tmp_path).keys() == before.keys()
    # All is there: nothing is sampled, and the same is said again.
    told = Stopping(-1)
    here(config, folder, "resume", told)
    table = (folder / "comparison.csv").read_bytes()
    assert table == (done.folder / "comparison.csv").read_bytes()


def test_a_config_that_is_wrong_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    config = systems.small(tmp_path, ("k_s: nominal", "k_s: nominall"))
    ran = systems.cli("ladder", config, "-o", tmp_path / "out")
    assert ran.status == 2
    assert "parameters.k_s" in ran.err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_processes_and_a_cluster_come_to_the_same(done: Done, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    table = (done.folder / "comparison.csv").read_bytes()
    ran = systems.cli("ladder", done.config, "-o", tmp_path / "two", "--processes", "2")
    assert ran.status == 0, ran.text
    assert "recommended: dry friction at the motor" in ran.out
    assert (tmp_path / "two" / "comparison.csv").read_bytes() == table
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        remote.dask_executor(cluster.scheduler_address) as crew,
    ):
        ladder.ladder(prepare(done.config), tmp_path / "three", "fresh", crew, Silent())
    assert (tmp_path / "three" / "comparison.csv").read_bytes() == table
