"""What draws determine only because they count on noise without memory is not called determined."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import command_line
from support.case_tables import run_cases

import bayesdrill as bd

T = 0.02 * np.arange(1000)
V = np.where(np.sin(0.9 * T) > 0, 6.0, 3.0)
RHO = (
    0.5  # of what the record has beside the motion: sds are too small by 1.7, and the fit believed
)
SAMPLER = {"walkers": 32, "ess": 400, "n_tau": 20}


def remembering(rho: float, rng: np.random.Generator) -> np.ndarray:
    """An AR(1) of unit variance."""
    noise = np.zeros(len(T))
    for k in range(1, len(T)):
        noise[k] = rho * noise[k - 1] + rng.standard_normal()
    return noise / noise.std()


def motor(widths: float, rho: float = RHO, **entries: Any) -> bd.Case:
    """A motor whose two unknowns have priors so many times as wide as white noise would leave them."""
    rig = bd.Motor(added=("k_e", "k_T", "r_m", "l_m"))
    p = {"j_m": 0.02, "c_m": 0.05, "k_e": 0.5, "k_T": 0.5, "r_m": 1.0, "l_m": 0.001}
    clean = bd.respond(rig, p, T, {"v": V}, "w_2")["w_2"]
    believed = dict(p) | {
        "c_m": {"prior": "normal", "mean": 0.05, "sd": 6e-5 * widths},
        "j_m": {"prior": "normal", "mean": 0.02, "sd": 8e-5 * widths},
    }
    return noisy(clean, "w_2", {"v": bd.Input(V, "V")}, believed, rig, rho, **entries)


def train(widths: float, rho: float = RHO) -> bd.Case:
    """Two inertias with a shaft between them, driven by a torque."""
    ends = ("motor", "load")
    rig = bd.Train(ends, {"shaft": ends}, drives={"motor": "torque"}, added=("c_load",))
    p = {"j_motor": 0.1, "j_load": 0.2, "k_shaft": 30.0, "c_load": 0.5}
    clean = bd.respond(rig, p, T, {"t_motor": V}, "w_load")["w_load"]
    believed = dict(p) | {"c_load": {"prior": "normal", "mean": 0.5, "sd": 9.5e-5 * widths}}
    return noisy(clean, "w_load", {"t_motor": bd.Input(V, "N*m")}, believed, rig, rho)


def noisy(
    clean: np.ndarray,
    channel: str,
    inputs: Any,
    believed: Any,
    rig: Any,
    rho: float,
    **entries: Any,
) -> bd.Case:
    y = clean + 0.05 * remembering(rho, np.random.default_rng(3))
    sigma = {"prior": "log_uniform", "low": 0.01, "high": 1.0}
    channels = {channel: bd.Channel(y, "rad/s", sigma)}
    return bd.case(T, channels, inputs, believed, rig=rig, sampler=SAMPLER, **entries)


@cache
def sampled(name: str) -> bd.Run:
    case = {
        "a motor of wide priors": lambda: motor(12.0),
        "a motor of white noise": lambda: motor(2.6, rho=0.0),
        "a motor with a table": lambda: motor(2.6, nominal={"j_m": 0.02, "c_m": 0.05}),
        "a train": lambda: train(2.6),
    }[name]()
    return case.sample(seed=1)


DOUBTED = {"a motor with a table": ("c_m",), "a train": ("c_load",)}


@run_cases("name", DOUBTED)
def test_a_run_is_not_believed_that_determines_by_its_own_sds_alone(name: str) -> None:
    """Mutant killed: as long as the correlation of neighbours is small enough, all is well."""
    run = sampled(name)
    report = run.judge()
    assert {*DOUBTED[name]} <= {*run.analysis.unsupported}
    (reason,) = report.reasons
    assert "(sandwich), the record does not determine" in reason
    for row in run.analysis.unknowns:
        times = run.analysis.sandwich[row.name] / row.sd
        limit = 0.5 / (1 - row.shrinkage)
        said = row.name in run.analysis.unsupported
        assert said == (row.word == "determined" and times >= limit), row.name
        assert not said or f"{row.name} ({times:.3g} times as large)" in reason
    assert "DO NOT BELIEVE these numbers, though the ensembles converged" in report.text
    assert "the record says" not in report.text
    assert "determined:" not in report.text


def test_a_run_is_believed_whose_sandwich_sds_determine_as_well() -> None:
    """Or that leaves but noise, of which no sandwich is made."""
    wide, white = sampled("a motor of wide priors"), sampled("a motor of white noise")
    assert wide.judge().reasons == white.judge().reasons == ()
    assert wide.analysis.sandwich["c_m"] > 1.5 * np.std(wide.draws["c_m"])
    assert not white.analysis.sandwich
    for run in (wide, white):
        assert {row.word for row in run.analysis.unknowns} == {"determined"}
        assert "determined: j_m, c_m" in run.judge().text
    assert "Sandwich sds, in the report of a posterior, count that" in wide.judge().text


def test_products_of_a_verdict_are_held_against_their_sandwich_sds() -> None:
    """Each from the covariance of the logs, as draws have theirs where noise has no memory."""
    run = sampled("a motor with a table")
    judged = run.analysis.judged
    assert judged is not None
    for q in judged.verdict.products:
        names = [n for n, e in zip(judged.verdict.names, q.exponents, strict=True) if e]
        assert any(key.startswith(names[0]) for key in run.analysis.sandwich)
    assert "verdict: none, because the model does not fit" in run.judge().text


@pytest.mark.parametrize("doubted", [True, False])
def test_identify_at_a_maximum_says_determined_by_the_same_rule(doubted: bool) -> None:
    made = motor(2.6 if doubted else 12.0)
    findings = made.identify(at=made.find_map())
    assert bool(findings.reasons) == doubted
    assert ("DO NOT BELIEVE these numbers" in findings.text) == doubted
    assert ("determined" in findings.text.replace("does not determine", "")) != doubted


def test_commands_end_with_status_3(tmp_path: Path) -> None:
    made = motor(2.6)
    np.savetxt(
        tmp_path / "r.csv",
        np.stack([T, made.columns["w_2"], V], axis=-1),  # type: ignore[index]
        delimiter=",",
        header="t,w,v",
        comments="",
    )
    (tmp_path / "c.yaml").write_text(
        "name: c\nseed: 1\nrecord:\n  file: r.csv\n  time: {column: t, unit: s}\n  channels:\n"
        "    w_2: {column: w, unit: rad/s, sigma: {prior: log_uniform, low: 0.01, high: 1}}\n"
        "inputs: {v: {column: v, unit: V}}\nmodel: {name: motor}\nparameters:\n"
        "  j_m: {prior: normal, mean: 0.02, sd: 2.08e-4}\n"
        "  c_m: {prior: normal, mean: 0.05, sd: 1.56e-4}\n"
        "  k_e: 0.5\n  k_T: 0.5\n  r_m: 1.0\n  l_m: 0.001\n"
        "map: {starts: 1}\nsampler: {walkers: 16, r_hat: 1.1, n_tau: 10, ess: 200}\n"
        "output: {predictive_draws: 10, figures: []}\n"
    )
    ran = command_line.cli(
        "posterior", tmp_path / "c.yaml", "-o", tmp_path / "out", "--processes", "1"
    )
    assert ran.status == 3, ran.text
    assert "the record does not determine c_m" in ran.out
    assert command_line.cli("verify", tmp_path / "out").status == 0
    assert command_line.cli("report", tmp_path / "out", "--processes", "1").status == 3
    ran = command_line.cli("identify", tmp_path / "c.yaml", "--at-map")
    assert ran.status == 3, ran.text
    assert command_line.cli("identify", tmp_path / "c.yaml").status == 0
