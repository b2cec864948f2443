"""Cases of arrays and of configs: the same posterior, mistakes with their names, and their jobs."""

from pathlib import Path

import numpy as np
import pytest
from support import command_line
from support.array_cases import BOX, T, run, two
from support.case_tables import run_cases
from support.command_line import ROOT
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.record.formats.csv import CsvOptions, read

CONFIG = ROOT / "configs" / "nominal_step.yaml"
ALL_FREE = dict.fromkeys(NOMINAL, BOX)


def test_a_case_of_arrays_has_the_posterior_of_its_file() -> None:
    case = bd.load(CONFIG)
    table = read(CONFIG.parent / "records" / "nominal_step.csv", CsvOptions())
    units = {"theta_1": "rad", "theta_2": "rad", "w_1": "rad/s", "w_2": "rad/s"}
    channels = {name: bd.Channel(table.variables[name], u, 0.1) for name, u in units.items()}
    same = bd.case(table.variables["t"], channels, {"v": 8.0}, ALL_FREE, nominal="tables_2_3")
    theta = case.job.problem.posterior.space.draw(20, np.random.default_rng(3))
    one, other = (of.job.problem.posterior.density(theta) for of in (case, same))
    assert np.isfinite(one).any()
    assert np.array_equal(one, other)
    assert same.unknowns == case.unknowns


def test_a_log_density_at_values_that_do_not_fit_the_unknowns_is_refused() -> None:
    with pytest.raises(bd.InputError) as error:
        two().log_density({"k_q": 0.3, "t_f": "much"})
    places = [problem.place for problem in error.value.problems]
    assert places == ["values.k_q", "values.k_s", "values.t_f"]
    with pytest.raises(bd.InputError, match="one length for all series"):
        two().log_density({"k_s": [0.3, 0.31], "t_f": [0.1, 0.1, 0.1]})


MASKED = np.ma.masked_greater(np.where(T[3] == T, 9999.0, np.sin(T)), 9000.0)
GAP = np.where(T[17] == T, np.nan, 1.0)
DATES = np.datetime64("2026-01-01") + np.arange(len(T)) * np.timedelta64(20, "ms")


@run_cases(
    "changes, message",
    [
        ({"t": DATES}, "t: these are dates or durations; give seconds"),
        ({"t": T[::-1]}, "does not increase"),
        ({"t": T * 1j}, "t: give an array of numbers, not complex128"),
        ({"t": T[:-1]}, "w_1: 241 values, but there are 240 times"),
        ({"channels": {}}, "nothing is measured; give a bd.Channel"),
        ({"channels": {"w_1": T}}, "channels.w_1: give a bd.Channel.* not ndarray"),
        ({"w_1": (MASKED, "rad/s", 0.1)}, "sample 4"),
        ({"w_1": (GAP, "rpm", 0.1)}, "sample 18"),
        ({"w_1": (T.reshape(1, -1, 1), "rad/s", 0.1)}, "one row of numbers"),
        ({"w_1": ([[1.0], [1.0, 2.0]], "rad/s", 0.1)}, "w_1: give an array of numbers, not list"),
        ({"w_1": ("rad/s", T, 0.1)}, "channels.w_1: give an array"),
        ({"w_1": (T, "rad/s", T)}, "channels.w_1.sigma: no entry can be nda"),
        ({"w_1": (T, "rad/s", 0.1, "whit")}, "'whit' is not a noise; did you mean white"),
        (
            {"inputs": {"v": T}},
            "(?s)inputs.v: array.* is not a number; give a number in SI or a bd",
        ),
        ({"inputs": {"v": bd.Input(T[:3], "V")}}, "v: 3 values, but there are 241 times"),
        ({"parameters": ALL_FREE | {"k_s": 1j}}, "parameters.k_s: no entry can be"),
        ({"rig": bd.MotorShaft}, "rig: give a name .* or a model, such as MotorShaft"),
        ({"rig": "motorshaft"}, "did you mean motor_shaft"),
        ({"rig": bd.MotorShaft(added=("v_d",))}, r"parameters\.v_d: is missing; give a prior"),
        ({"model": {"i_m": 0.2}}, "model: arrays and `rig` give this already"),
        ({"record": {"time": {"rate": 9.0}}}, "record.time: arrays and `rig` give this already"),
        ({"record": "drop"}, "record: give entries, such as a window"),
        ({"record": {"mising": "drop"}}, "mising: unknown key; did you mean missing"),
        ({"record": {"window": [1.0, 0.5]}}, "1 s is not before 0.5 s"),
        ({"seed": -1}, "seed"),
    ],
)
def test_a_mistake_in_a_case_of_arrays_is_named(changes: dict[str, object], message: str) -> None:
    """`w_1` stands for a channel of these values, unit, sigma (and noise)."""
    values, unit, sigma, *noise = changes.pop("w_1", (np.sin(T), "rad/s", 0.1))  # type: ignore[misc]
    channel = bd.Channel(values, unit, sigma, **({"noise": noise[0]} if noise else {}))
    arguments = {"t": T, "channels": {"w_1": channel}, "inputs": {"v": 5.0}, "parameters": ALL_FREE}
    with pytest.raises(bd.InputError, match=message):
        bd.case(**arguments | changes)  # type: ignore[arg-type]


def test_a_wrong_start_of_sampling_or_nominal_table_is_refused() -> None:
    best = bd.Best(run().job, run().mode)
    with pytest.raises(bd.InputError, match="processes: 1000000000 are more than 256"):
        two().find_map(processes=10**9)
    with pytest.raises(bd.InputError, match="the maximum of another case"):
        two(initial={"w_1": 1.0}).sample(best)
    with pytest.raises(bd.InputError, match="did you mean"):
        bd.nominal("tables_2_4")


def test_a_case_of_a_config_does_what_the_commands_do(tmp_path: Path) -> None:
    """With the same words, the same folders and the same refusals."""
    config, out = command_line.small_config(tmp_path / "rig"), tmp_path / "out"
    case = bd.load(config)
    assert command_line.cli("check", config).out == f"{case.preview()}\n"
    best = case.find_map()
    assert command_line.cli("map", config, "--processes", "1").out == f"{best.table}\n"
    assert command_line.cli("identify", config).out == f"{case.identify()}\n"
    findings = case.identify("k_e", at=best)
    assert (findings.study.at, [one.name for one in findings.profiles]) == ("the MAP", ["k_e"])
    assert findings.save(tmp_path / "identify").startswith(str(tmp_path / "identify"))
    with pytest.raises(bd.InputError, match="exists already"):
        case.check_place(tmp_path / "identify")
    result = case.run(out)
    report = command_line.cli("report", out).out
    assert f"{result.summary}\nresults: {out}/" in report
    assert bd.publish(out).rows == result.rows
    with pytest.raises(bd.InputError, match="results exist already"):
        case.run(out)
    with pytest.raises(bd.InputError, match="exclude each other"):
        case.run(out, resume=True, force=True)
    with pytest.raises(bd.InputError, match="no file contains these arrays"):
        two().run(tmp_path / "arrays")
    assert case.place() == Path("results/small")


def test_a_config_is_simulated_and_calibrated_before_anything_is_measured(tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path / "rig")
    simulated = bd.simulate(config, tmp_path / "record.csv", seed=4)
    assert simulated.samples == 101 == len(simulated.path.read_text().splitlines()) - 1
    with pytest.raises(bd.InputError, match="seed: -1"):
        bd.simulate(config, tmp_path / "record.csv", seed=-1, force=True)
    (tmp_path / "rig" / "small.csv").unlink()
    calibration = bd.calibration(config)
    assert calibration.place() == Path("results/small-calibration")
    with pytest.raises(bd.InputError, match="exclude each other"):
        calibration.run(resume=True, force=True)
    assert '"motor_shaft"' in bd.schema()
