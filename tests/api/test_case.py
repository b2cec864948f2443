"""The package in memory: the same answers as from files, and results that show themselves."""

from __future__ import annotations

import dataclasses
import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray
from scipy import stats
from support import command_line
from support.array_cases import BOX, SHAFT, T, noisy, run, two
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, by_expm

import bayesdrill as bd
from bayesdrill.config import job
from bayesdrill.record.formats.csv import CsvOptions, read
from bayesdrill.rig.models.motor_shaft import MotorShaft

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "configs" / "nominal_step.yaml"


def test_the_response_is_that_of_the_matrix_exponential() -> None:
    start = {"theta_1": 0.3, "w_1": -0.2}
    inputs, signals = {"v": 5.0, "t_1": 0.2}, ["w_1", "theta_1 - theta_2"]
    found = bd.respond(MotorShaft(), SHAFT, T, inputs, signals, initial=start)
    exact = by_expm(SHAFT, T, np.array([0.3, 0.0, -0.2, 0.0, 0.0]), 5.0, 0.2)
    assert found["w_1"] == pytest.approx(exact[:, 2], rel=1e-9, abs=1e-12)
    twist = exact[:, 0] - exact[:, 1]
    assert found["theta_1 - theta_2"] == pytest.approx(twist, rel=1e-9, abs=1e-12)


def test_a_case_of_arrays_is_that_of_the_file() -> None:
    """The bundled config once more, of the columns of its record."""
    filed = bd.load(CONFIG)
    table = read(CONFIG.parent / "records" / "nominal_step.csv", CsvOptions())
    units = {"theta_1": "rad", "theta_2": "rad", "w_1": "rad/s", "w_2": "rad/s"}
    case = bd.case(
        table.variables["t"],
        {name: bd.Channel(table.variables[name], unit, 0.1) for name, unit in units.items()},
        {"v": 8.0},
        dict.fromkeys(NOMINAL, BOX),
        nominal="tables_2_3",
    )
    theta = filed.job.problem.posterior.space.draw(20, np.random.default_rng(3))
    one, other = (of.job.problem.posterior.density(theta) for of in (filed, case))
    assert np.isfinite(one).any()
    assert np.array_equal(one, other)
    assert case.unknowns == filed.unknowns


def test_all_mistakes_of_arrays_are_told_at_once() -> None:
    values = np.ones(len(T))
    values[17] = np.nan
    channels = {
        "w_2": bd.Channel(values, "rpm", 0.1),
        "w_1": bd.Channel(np.arange(241.0), "V", 0.1),
    }
    with pytest.raises(bd.InputError) as told:
        bd.case(T, channels, {"v": 5.0}, dict.fromkeys(NOMINAL, BOX) | {"k_z": BOX})
    text = str(told.value)
    assert "arrays: record.channels.w_1.unit" in text
    assert "arrays: parameters.k_z: unknown symbol" in text
    with pytest.raises(bd.InputError, match="sample 18"):
        bd.case(T, {"w_2": channels["w_2"]}, {"v": 5.0}, dict.fromkeys(NOMINAL, BOX))


GOOD = bd.Channel(np.sin(T), "rad/s", 0.1)
MASKED = np.ma.masked_greater(np.where(T[3] == T, 9999.0, np.sin(T)), 9000.0)
DATES = np.datetime64("2026-01-01") + np.arange(len(T)) * np.timedelta64(20, "ms")


@run_cases(
    "changes, message",
    [
        ({"t": DATES}, "t: these are dates or durations; give seconds"),
        ({"t": T[::-1]}, "does not increase"),
        ({"t": None}, "t: wanted is an array of numbers, not NoneType"),
        ({"t": T * 1j}, "t: wanted is an array of numbers, not complex128"),
        ({"t": T[:-1]}, "w_1: 241 values, but there are 240 times"),
        ({"channels": {}}, "nothing is measured; give a bd.Channel"),
        ({"channels": None}, "channels: give a bd.Channel.* not NoneType"),
        ({"channels": {"w_1": T}}, "channels.w_1: give a bd.Channel.* not ndarray"),
        ({"channels": {"w_1": bd.Channel(MASKED, "rad/s", 0.1)}}, "sample 4"),
        (
            {"channels": {"w_1": bd.Channel(T.reshape(1, -1, 1), "rad/s", 0.1)}},
            "one row of numbers",
        ),
        ({"channels": {"w_1": bd.Channel([[1.0], [1.0, 2.0]], "rad/s", 0.1)}}, "w_1: wanted"),
        ({"channels": {"w_1": bd.Channel("rad/s", T, 0.1)}}, "channels.w_1: wanted is an array"),
        (
            {"channels": {"w_1": bd.Channel(T, "rad/s", T)}},
            r"channels.w_1.sigma: no entry can be nda",
        ),
        (
            {"inputs": {"v": T}},
            "(?s)inputs.v: array.* is not a number; give a number in SI or a bd.In",
        ),
        ({"inputs": {"v": bd.Input(T[:3], "V")}}, "v: 3 values, but there are 241 times"),
        ({"inputs": None}, "inputs: give a number in SI or a bd.Input"),
        ({"parameters": ["k_s"]}, "parameters: give a prior, a number"),
        (
            {"parameters": dict.fromkeys(NOMINAL, BOX) | {"k_s": 1j}},
            "parameters.k_s: no entry can be",
        ),
        ({"rig": MotorShaft}, "rig: give a name .* or a model, such as MotorShaft"),
        ({"rig": "motorshaft"}, "did you mean motor_shaft"),
        ({"model": {"i_m": 0.2}}, "model: arrays and `rig` say this already"),
        ({"record": {"time": {"rate": 9.0}}}, "record.time: arrays and `rig` say this already"),
        ({"record": "drop"}, "record: give entries, such as a window"),
        ({"record": {"mising": "drop"}}, "mising: unknown key; did you mean missing"),
        ({"record": {"window": [1.0, 0.5]}}, "1 s is not before 0.5 s"),
        ({"seed": -1}, "seed"),
    ],
)
def test_a_mistake_has_its_name(changes: dict[str, object], message: str) -> None:
    arguments = {
        "t": T,
        "channels": {"w_1": GOOD},
        "inputs": {"v": 5.0},
        "parameters": dict.fromkeys(NOMINAL, BOX),
    }
    with pytest.raises(bd.InputError, match=message):
        bd.case(**arguments | changes)  # type: ignore[arg-type]


@run_cases("hold", ["zero", "first"])
def test_a_response_at_uneven_times_is_that_at_a_grid_which_holds_them(hold: str) -> None:
    """With a voltage that changes at those times alone."""
    fine = 0.25 + 0.005 * np.arange(201)
    picked = np.array([0, 3, 4, 40, 41, 90, 170, 200])
    v = np.array([6.0, -3.0, 5.0, 4.0, -7.0, 1.0, 2.0, 2.0])
    if hold == "first":
        dense = np.interp(fine, fine[picked], v)
    else:
        dense = v[np.searchsorted(picked, np.arange(201), side="right") - 1]
    start = {"w_1": 3.0, "theta_2": 0.2}
    given = (["w_1", "theta_1 - theta_2"],)
    exact = bd.respond(MotorShaft(), SHAFT, fine, {"v": dense}, *given, initial=start, hold=hold)
    found = bd.respond(
        MotorShaft(), SHAFT, fine[picked], {"v": v}, *given, initial=start, hold=hold
    )
    for name, values in found.items():
        assert values == pytest.approx(exact[name][picked], rel=1e-9, abs=1e-10)


@run_cases(
    "changes, message",
    [
        ({"t": np.array([0.0, 0.5, 0.1])}, "t: "),
        ({"t": [0.0]}, "give at least two"),
        ({"parameters": {**NOMINAL, "j_1": -1.0}}, "parameters.j_1: -1.0 is not a positive number"),
        ({"parameters": {**NOMINAL, "x": 1.0}}, "parameters.x: the rig has none"),
        ({"parameters": {"k_s": 1.0}}, "parameters.j_m: is missing"),
        ({"inputs": {}}, "inputs.v: is missing"),
        ({"inputs": {"v": "8"}}, "inputs.v: '8' is not a number"),
        ({"inputs": {"v": np.ones(3)}}, "inputs.v: give one number for each of the times"),
        ({"inputs": {"v": 5.0, "u": 1.0}}, "inputs.u: the rig has none"),
        ({"hold": "cubic"}, "hold: 'cubic' is neither"),
        ({"initial": {"w_3": 1.0}}, "initial.w_3: the rig has none"),
        ({"initial": np.zeros(5)}, "initial: give a number for each state, not ndarray"),
        ({"signals": "w_3"}, "w_3"),
    ],
)
def test_what_no_rig_can_answer_is_refused(changes: dict[str, object], message: str) -> None:
    arguments = {"t": T, "parameters": NOMINAL, "inputs": {"v": 5.0}, "signals": ["w_1"]}
    with pytest.raises(bd.InputError, match=message):
        bd.respond(MotorShaft(), **arguments | changes)  # type: ignore[arg-type]


def test_what_samples_is_judged_before() -> None:
    case, best = two(), bd.Best(run().job, run().mode)
    with pytest.raises(bd.InputError, match="seed: -1"):
        case.sample(seed=-1)
    with pytest.raises(bd.InputError, match="processes: 0"):
        case.find_map(processes=0)
    with pytest.raises(bd.InputError, match="processes: 1000000000 are more than 256"):
        case.find_map(processes=10**9)
    with pytest.raises(bd.InputError, match="give what find_map found, not int"):
        case.sample(1)  # type: ignore[arg-type]
    with pytest.raises(bd.InputError, match="the maximum of another case"):
        two(initial={"w_1": 1.0}).sample(best)
    with pytest.raises(bd.InputError, match="did you mean"):
        bd.nominal("tables_2_4")


def test_a_run_says_what_it_found() -> None:
    judged = run().judge()
    rows = {row["name"]: row for row in judged.rows}
    assert rows["k_s"]["mean"] == pytest.approx(0.31, abs=4 * rows["k_s"]["sd"])
    assert judged.verdict is not None
    assert not judged.verdict.agrees
    assert "k_s" in str(judged)
    assert "| k_s |" in judged._repr_markdown_()
    assert re.search(r"verdict: .*disagree", str(run()))
    assert set(run().draws) == {"k_s", "t_f"}
    assert "k_s" in str(two().identify())
    assert "241 samples" in repr(two())
    assert "k_s" in str(bd.Best(run().job, run().mode))


def test_the_log_density_is_that_of_the_noise_and_the_priors() -> None:
    case, k_s = two(), np.array([0.3, 0.31])
    expected = []
    for value in k_s:
        log_p = -2.0 * np.log(1.5 - 0.5) - np.log(NOMINAL["k_s"] * NOMINAL["t_f"])
        for name, sigma in (("theta_2", 0.05), ("w_1", 0.1)):
            measured = case.columns[name] * (np.pi / 180 if name == "theta_2" else 1.0)
            values = {**NOMINAL, "k_s": value, "t_f": 0.09}
            exact = bd.respond(MotorShaft(), values, T, {"v": 5.0}, [name])[name]
            log_p += stats.norm.logpdf(measured, exact, sigma).sum()
        expected.append(log_p)
    assert case.log_density({"k_s": k_s, "t_f": 0.09}) == pytest.approx(expected, rel=1e-9)
    assert case.log_density({"k_s": 0.31, "t_f": 0.09}) == pytest.approx(expected[1:], rel=1e-9)
    draws = run().draws
    every = case.log_density({name: values[0] for name, values in draws.items()})
    assert every.shape == draws["k_s"][0].shape
    assert np.isfinite(every).all()
    assert case.log_density({"k_s": [9.0, np.nan], "t_f": 0.1}).tolist() == [-np.inf, -np.inf]


def test_a_log_density_at_values_that_do_not_fit_the_unknowns_is_refused() -> None:
    with pytest.raises(bd.InputError) as refused:
        two().log_density({"k_q": 0.3, "t_f": "much"})
    places = [problem.place for problem in refused.value.problems]
    assert places == ["values.k_q", "values.k_s", "values.t_f"]
    with pytest.raises(bd.InputError, match="and equally many"):
        two().log_density({"k_s": [0.3, 0.31], "t_f": [0.1, 0.1, 0.1]})


def test_the_same_seed_gives_the_same_draws_and_another_others() -> None:
    again, other = two().sample(seed=4), two(seed=3).sample(seed=5)
    assert np.array_equal(again.draws["k_s"], run().draws["k_s"])
    assert not np.array_equal(other.draws["k_s"][:, :50], run().draws["k_s"][:, :50])


def test_a_saved_run_opens_as_it_was(tmp_path: Path) -> None:
    """And is one of `bayesdrill posterior`, whose report makes the same tables again."""
    folder = run().save(tmp_path / "mine")
    opened = bd.open(folder)
    assert np.array_equal(opened.draws["t_f"], run().draws["t_f"])
    assert opened.judge().rows == run().judge().rows
    assert opened.converged == run().converged
    with xarray.open_datatree(folder / "posterior.nc", engine="h5netcdf") as tree:
        assert {*tree["derived"].data_vars} == {*run().to_arviz()["derived"].data_vars}
    before = (folder / "summary.csv").read_bytes()
    (folder / "summary.csv").unlink()
    assert command_line.cli("report", folder, "--processes", "1").status == 0
    assert (folder / "summary.csv").read_bytes() == before
    with pytest.raises(bd.InputError, match="results exist already"):
        run().save(folder)
    with pytest.raises(bd.InputError, match="holds the record of this run"):
        opened.save(folder, force=True)
    assert bd.open(folder).converged == run().converged
    with pytest.raises(bd.InputError, match="no results here"):
        bd.open(tmp_path / "nowhere")


def test_figures_and_the_tree_of_arviz() -> None:
    from matplotlib.figure import Figure

    assert isinstance(run().plot_corner(), Figure)
    figure = run().plot("fit")
    assert isinstance(figure, Figure)
    assert figure._repr_png_().startswith(b"\x89PNG")  # what a notebook shows, without pyplot
    with pytest.raises(bd.InputError, match="did you mean corner"):
        run().plot("cornor")
    tree = run().to_arviz()
    assert tree["posterior"]["k_s"].shape == run().draws["k_s"].shape
    assert tree["posterior"].attrs["seed"] == 4


def test_columns_as_text_read_back_the_same(tmp_path: Path) -> None:
    columns = {"t": np.array([0.0, 0.1, 1 / 3]), "w_1": np.array([1e-9, -2.5, 1e12])}
    file = tmp_path / "record.csv"
    file.write_text(job.arrays_as_csv(columns))
    table = read(file, CsvOptions())
    for name, values in columns.items():
        assert np.array_equal(table.variables[name], values)


def test_the_package_names_what_it_offers_and_loads_it_late() -> None:
    assert {"load", "case", "open", "respond", "MotorShaft"} <= set(dir(bd))
    assert all(getattr(bd, name) is not None for name in dir(bd))
    assert not [name for name in dir(bd) if (ROOT / "bayesdrill" / name).exists()]  # of a folder
    with pytest.raises(AttributeError, match="it has"):
        bd.posterior  # noqa: B018
    code = "import sys, bayesdrill; print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.slow
def test_the_notebook_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["notebook.py", str(tmp_path / "nb")])
        runpy.run_path(str(ROOT / "docs" / "notebook.py"))
    assert (tmp_path / "nb.png").exists()
    assert "verdict: " in capsys.readouterr().out


def test_what_the_command_line_does_with_files_python_does(tmp_path: Path) -> None:
    """The same words, the same folders, the same refusals."""
    config = command_line.small_config(tmp_path / "rig")
    case = bd.load(config)
    checked = command_line.cli("check", config)
    assert checked.out == f"{case.preview()}\n"
    best = case.find_map()
    assert command_line.cli("map", config, "--processes", "1").out == f"{best.table}\n"
    assert command_line.cli("identify", config).out == f"{case.identify()}\n"
    found = case.identify("k_e", at=best)
    assert (found.study.at, [one.name for one in found.profiles]) == ("the MAP", ["k_e"])
    assert found.save(tmp_path / "identify").startswith(str(tmp_path / "identify"))
    with pytest.raises(bd.InputError, match="exists already"):
        case.check_place(tmp_path / "identify")
    outcome = case.run(tmp_path / "out")
    assert (
        f"{outcome.summary}\nresults: {tmp_path / 'out'}/"
        in command_line.cli("report", tmp_path / "out").out
    )
    assert bd.publish(tmp_path / "out").rows == outcome.rows
    with pytest.raises(bd.InputError, match="results exist already"):
        case.run(tmp_path / "out")
    with pytest.raises(bd.InputError, match="exclude each other"):
        case.run(tmp_path / "out", resume=True, force=True)
    with pytest.raises(bd.InputError, match="arrays are in no file"):
        two().run(tmp_path / "arrays")
    assert case.place() == Path("results/small")


def test_records_and_calibrations_of_a_config(tmp_path: Path) -> None:
    """What a calibration finds is tested by the command line, which is a user of this."""
    config = command_line.small_config(tmp_path / "rig")
    made = bd.simulate(config, tmp_path / "record.csv", seed=4)
    assert made.samples == 101 == len(made.path.read_text().splitlines()) - 1
    with pytest.raises(bd.InputError, match="seed: -1"):
        bd.simulate(config, tmp_path / "record.csv", seed=-1, force=True)
    (tmp_path / "rig" / "small.csv").unlink()  # nothing has to be measured yet
    calibration = bd.calibration(config)
    assert calibration.place() == Path("results/small-calibration")
    with pytest.raises(bd.InputError, match="exclude each other"):
        calibration.run(resume=True, force=True)
    assert '"motor_shaft"' in bd.schema()


def test_the_noise_of_a_channel_is_told_as_in_a_config() -> None:
    channel = noisy("w_1", 1.0, 0.1)
    with pytest.raises(bd.InputError, match="'whit' is not a noise; did you mean white"):
        bd.case(
            T,
            channels={"w_1": dataclasses.replace(channel, noise="whit")},
            inputs={"v": 5.0},
            parameters=dict.fromkeys(NOMINAL, "nominal") | {"k_s": BOX},
        )


def test_a_figure_that_fails_is_told_when_a_run_is_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ValueError("cannot do this")

    with monkeypatch.context() as patch:
        patch.setattr("bayesdrill.report.sections.physics_words.derived_shown", fail)
        with pytest.warns(
            UserWarning, match=r"figures/corner \(ValueError: cannot do this\)"
        ) as told:
            folder = run().save(tmp_path / "mine")
    assert told[0].filename == __file__
    assert (folder / "summary.csv").exists()
    assert run().save(tmp_path / "again").exists()  # what could be made this time is not missing
