"""Runs whose unknowns are determined only as far as their residuals are not correlated."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support import command_line
from support.command_line import CONFIGS
from support.missing_physics import ar1
from support.unexplained_records import try_only

import bayesdrill as bd
from bayesdrill.report.publish import drawings
from bayesdrill.tasks import conclusions

T = 0.02 * np.arange(1000)
TORQUE = np.where(np.sin(0.9 * T) > 0, 3.0, 1.5)
RHO = 0.5  # of the residuals: sds are too small by 1.7, and the fit is believed
SAMPLER = {"walkers": 32, "ess": 400, "n_tau": 20}
VALUES = {"j_m": 0.02, "c_m": 0.3}
SDS = {"j_m": 8e-5, "c_m": 6e-5}  # as white noise would leave them
NARROW, WIDE = 2.6, 12.0  # sds of priors over these


@pytest.fixture(autouse=True)
def without_causes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no causes of the bad fit be ranked, which takes half a minute."""
    monkeypatch.setattr(conclusions, "causes", lambda *_: None)


@cache
def record(rho: float) -> np.ndarray:
    """Return the speed of the motor with autoregressive residuals."""
    clean = bd.respond("motor", VALUES, T, {"t_m": TORQUE}, "w_2")["w_2"]
    noise = ar1(rho, T.shape, 3)
    return clean + 0.05 * noise / noise.std()


@cache
def run(widths: float, rho: float = RHO) -> bd.Run:
    """Return a run whose two unknowns have normal priors of the sds `SDS` times `widths`."""
    priors = {
        name: {"prior": "normal", "mean": VALUES[name], "sd": sd * widths}
        for name, sd in SDS.items()
    }
    sigma = {"prior": "log_uniform", "low": 0.01, "high": 1.0}
    channels = {"w_2": bd.Channel(record(rho), "rad/s", sigma)}
    table, inputs = VALUES if widths == NARROW else None, {"t_m": bd.Input(TORQUE, "N*m")}
    case = bd.case(T, channels, inputs, priors, rig="motor", sampler=SAMPLER, nominal=table)
    return case.sample(seed=1)


@pytest.mark.slow
def test_a_run_is_not_believed_whose_sandwich_sds_do_not_determine_an_unknown() -> None:
    doubted = run(NARROW)
    report, analysis = doubted.judge(), doubted.analysis
    assert "c_m" in analysis.unsupported
    (reason,) = report.reasons
    assert "(sandwich), the record does not determine" in reason
    for row in analysis.unknowns:
        ratio = analysis.sandwich[row.name] / row.sd
        unsupported = row.word == "determined" and ratio >= 0.5 / (1 - row.shrinkage)
        assert (row.name in analysis.unsupported) == unsupported, row.name
        assert (f"{row.name} (sd {ratio:.3g} times as large)" in reason) == unsupported
    assert "DO NOT BELIEVE these numbers, though the ensembles converged" in report.text
    assert "the record says" not in report.text
    assert "determined:" not in report.text
    assert "verdict: none, because the model does not fit" in report.text
    assert drawings("residuals", doubted._view)  # though nobody asks for it
    for q in analysis.judged.verdict.products:  # each has a sandwich sd from the covariance of logs
        names = zip(analysis.judged.verdict.names, q.exponents, strict=True)
        first = next(name for name, exponent in names if exponent)
        assert any(key.startswith(first) for key in analysis.sandwich)


@pytest.mark.slow
@pytest.mark.parametrize(("widths", "rho"), [(WIDE, RHO), (NARROW, 0.0)])
def test_a_run_is_believed_whose_sandwich_sds_determine_as_well(widths: float, rho: float) -> None:
    """Or that leaves white noise, of which no sandwich is made."""
    believed = run(widths, rho)
    assert believed.judge().reasons == ()
    assert {row.word for row in believed.analysis.unknowns} == {"determined"}
    assert "determined: j_m, c_m" in believed.judge().text
    if rho:
        assert believed.analysis.sandwich["c_m"] > 1.5 * np.std(believed.draws["c_m"])
        assert "Sandwich sds in the report of a posterior allow for it" in believed.judge().text
    else:
        assert not believed.analysis.sandwich
        assert not drawings("residuals", believed._view)


def test_commands_end_with_status_3(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    try_only({"offset_w_2"}, monkeypatch)
    rows = np.stack([T, record(RHO), TORQUE], axis=-1)
    config, folder = tmp_path / "c.yaml", tmp_path / "out"
    np.savetxt(tmp_path / "r.csv", rows, delimiter=",", header="t,w,torque", comments="")
    config.write_text((CONFIGS / "motor.yaml").read_text(encoding="utf-8"))
    posterior = command_line.cli("posterior", config, "-o", folder, "--processes", "1")
    assert posterior.status == 3, posterior.text
    assert "the record does not determine c_m" in posterior.out
    analysis = json.loads((folder / "run.json").read_text())["analysis"]
    summary = (folder / "summary.md").read_text(encoding="utf-8")
    assert "sd if residuals remember (sandwich)" in summary
    for row in analysis["unknowns"]:
        assert f"{analysis['sandwich'][row['name']] / row['sd']:.3g}" in summary
    for status, *arguments in ((3, "identify", config, "--at-map"), (0, "identify", config)):
        result = command_line.cli(*arguments)
        assert result.status == status, result.text
