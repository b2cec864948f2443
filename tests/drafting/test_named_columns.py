"""What a newcomer says beside the record: columns, the rig, a rate, a sheet; several files of one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from support import command_line
from support.first_configs import DEG, accepted, both_ways, german, made, told, written

import bayesdrill as bd
from bayesdrill.config.yaml_source import parse
from bayesdrill.drafting.columns import named_column


def refused(*arguments: Any) -> str:
    done = command_line.cli("init", *arguments)
    assert done.status == 2
    assert "Traceback" not in done.err
    return str(done.err)


@pytest.fixture
def matrix(tmp_path: Path) -> Path:
    """A matrix without heads: time, angle at the gearbox in degrees, voltage, and what is no signal."""
    t, v, x = both_ways()
    rng = np.random.default_rng(3)
    angle = x[:, 1] * DEG + rng.normal(0, 0.1, len(t))
    data = np.stack([t, rng.normal(size=len(t)), angle, v], axis=-1)
    scipy.io.savemat(tmp_path / "m.mat", {"data_theta": data})
    return tmp_path / "m.mat"


def test_columns_of_a_matrix_are_named(matrix: Path) -> None:
    columns = ["data_theta:3=theta_2 [deg]", "data_theta:4=v [V]", "data_theta:1=t [s]"]
    found = made(matrix, columns=columns, gear=5)
    assert told(found) == {"theta_2": ("3", "deg")}
    assert found["inputs"]["v"]["column"] == 4
    assert found["record"]["time"] == {"variable": "data_theta", "column": 1, "unit": "s"}
    assert "measures" not in found["record"]["channels"]["theta_2"]
    accepted(matrix.with_suffix(".yaml"))
    against = made(matrix, columns=["data_theta:3=-theta_2 [deg]", *columns[1:]], gear=5)
    assert against["record"]["channels"]["theta_2"]["measures"] == "-theta_2"


def test_a_matrix_that_says_nothing_is_refused_with_what_to_type(matrix: Path) -> None:
    said = refused(matrix)
    assert '--columns "data_theta:2=theta_2 [deg]"' in said
    assert "data_theta, column 3 (" in said
    assert "data_theta:9" in refused(matrix, "--columns", "data_theta:9=theta_2 [deg]")
    assert "names no known quantity" in refused(matrix, "--columns", "data_theta:3=theta_2 [rpm]")
    assert "names no known quantity" in refused(matrix, "--columns", "data_theta:3=colour")
    assert "is not a rig; did you mean motor" in refused(matrix, "--rig", "motr")


def test_the_name_of_a_file_may_stand_before_a_column() -> None:
    found = named_column("b.mat:data:2=w_1 [rpm]", ["a.mat", "b.mat"])
    assert (found.file, found.variable, found.column) == ("b.mat", "data", 2)
    assert (found.meaning.symbol, found.meaning.unit) == ("w_1", "rpm")


def test_structures_of_simulink_are_read(tmp_path: Path) -> None:
    t, v, x = both_ways()
    signals = np.zeros((1, 2), dtype=[("values", "O"), ("label", "O"), ("plotStyle", "O")])
    signals[0, 0] = (v[:, None], "voltage [V]", 0)
    signals[0, 1] = (x[:, 2:3], "w_1 [rad/s]", 0)
    scope = {"time": t[:, None], "signals": signals, "blockName": "rig/Scope"}
    scipy.io.savemat(tmp_path / "s.mat", {"scope": scope})
    found = made(tmp_path / "s.mat", gear=5)
    assert told(found) == {"w_1": ("scope.signals(2).values", "rad/s")}
    assert found["inputs"]["v"]["column"] == "scope.signals(1).values"
    accepted(tmp_path / "s.yaml")
    scipy.io.savemat(tmp_path / "two.mat", {"a": scope, "b": scope})
    said = refused(tmp_path / "two.mat")
    assert "holds 2 records: a, b" in said
    assert '--columns "a.signals(1).values=' in said


def test_files_of_one_signal_each_are_one_record(tmp_path: Path) -> None:
    """Named by file; one of them has a clock of its own."""
    t, v, x = both_ways()
    scipy.io.savemat(tmp_path / "theta_2_rad.mat", {"data": np.stack([t, x[:, 1]], axis=-1)})
    written(tmp_path / "omega_1_rad_s.csv", {"t": t[::2], "value": x[::2, 2]})
    scipy.io.savemat(tmp_path / "voltage.mat", {"ans": np.stack([t, v])})  # as "To File" writes
    files = [tmp_path / n for n in ("theta_2_rad.mat", "omega_1_rad_s.csv", "voltage.mat")]
    config = tmp_path / "all.yaml"
    said = bd.init(files, config, gear=5)
    assert {*said.channels} == {"theta_2", "w_1"}
    found = parse(config, said.text).data
    assert "experiments" not in found
    named = {found["record"]["file"]} | {
        one["file"] for one in found["record"]["channels"].values() if "file" in one
    }
    assert named | {found["inputs"]["v"]["file"]} == {file.name for file in files}
    accepted(config)


def test_without_a_sheet_no_value_of_another_rig_is_filled_in(tmp_path: Path) -> None:
    """Priors follow the record: a rig with a thousandth of the torque has priors around a thousandth."""
    columns = german()
    found = made(written(tmp_path / "r.csv", columns), gear=5)
    assert "nominal" not in found
    assert all(
        prior == 0.0 or prior["prior"] == "log_uniform" for prior in found["parameters"].values()
    )
    small = {**columns, "U_Motor": 1e-3 * columns["U_Motor"]}
    other = made(written(tmp_path / "s.csv", small), gear=5)["parameters"]
    for name, power in {"k_e": 1, "k_T": 1, "j_1": 2, "k_s": 2}.items():
        ratio = other[name]["low"] / found["parameters"][name]["low"]
        assert ratio == pytest.approx(1e-3**power, rel=0.1), name
    accepted(tmp_path / "r.yaml")


def test_a_data_sheet_becomes_the_nominal_table(tmp_path: Path) -> None:
    record = written(tmp_path / "r.csv", german())
    sheet = tmp_path / "sheet.yaml"
    sheet.write_text(
        "j_m: {value: 0.5, unit: g*m^2, side: load}\nk_T: {value: 45, unit: mN*m/A}\nc_s: 0.001\n"
    )
    found = made(record, gear=5, sheet=sheet)
    assert found["nominal"]["j_m"] == {"value": 0.5, "unit": "g*m^2", "side": "load"}
    assert found["parameters"]["k_T"]["relative"]
    assert found["parameters"]["k_e"]["prior"] == "log_uniform"
    assert "c_s" in found["parameters"]
    nominal = bd.load(tmp_path / "r.yaml").job.problem.nominal
    assert nominal["j_m"] == pytest.approx(0.5e-3 / 25)
    assert nominal["k_T"] == pytest.approx(0.045)
    assert {*nominal} == {"j_m", "k_T", "c_s"}
    sheet.write_text("k_T: {value: 45, unit: mN*m/A, side: load}\nj_x: 3\n")
    said = refused(record, "--sheet", sheet, "--force")
    assert "sheet.yaml: k_T" in said
    assert "j_x" in said


def test_rigs_by_their_names(tmp_path: Path) -> None:
    columns = german()
    t, top = columns["Zeit_ms"], np.cumsum(columns["U_Motor"])
    shaft = {"Zeit_ms": t, "theta_2 [rad]": top, "w_1 [rad/s]": columns["n_Rotor"]}
    found = made(written(tmp_path / "d.csv", shaft), rig="driven_shaft")
    assert [*found["record"]["channels"]] == ["w_1"]
    assert found["inputs"]["theta_2"]["column"] == "theta_2 [rad]"
    assert "v" not in found["inputs"]
    assert {*found["parameters"]} == {"k_s", "j_1"}
    assert found["model"] == {"name": "driven_shaft"}
    accepted(tmp_path / "d.yaml")
    alone = {
        "Zeit_ms": t,
        "motor torque [N*m]": columns["U_Motor"],
        "w_2 [rad/s]": columns["n_Motor"],
    }
    found = made(written(tmp_path / "m.csv", alone), rig="motor")
    assert {*found["parameters"]} == {"j_m", "c_m"}
    assert found["inputs"]["t_m"]["unit"] == "N*m"
    accepted(tmp_path / "m.yaml")


def test_a_rig_that_nothing_drives_begins_in_an_unknown_state(tmp_path: Path) -> None:
    """A beam that is held and then let go, its upper end at rest.  Mutant killed: a start at rest."""
    t = 0.001 * np.arange(2000)
    angle = 12.0 * np.where(t < 0.1, 1.0, np.exp(-(t - 0.1)) * np.cos(24.0 * (t - 0.1)))
    noisy = angle + np.random.default_rng(1).normal(0, 0.1, len(t))
    path = tmp_path / "decay.csv"
    table = np.column_stack([t, noisy])
    np.savetxt(path, table, "%.6g", ",", header="t [s],theta_1 [deg]", comments="")
    found = made(path, rig="driven_shaft")
    assert found["initial"] == "free"
    assert found["record"]["window"][0] == pytest.approx(0.1, abs=0.02)
    assert "t_0" not in found["inputs"]
    accepted(path.with_suffix(".yaml"))


def bench(path: Path) -> Path:
    """Two inertias that a current drives; the load counts backwards."""
    t, u, x = both_ways()
    columns = {"a": t, "b": u, "c": x[:, 1], "d": -x[:, 0]}
    return written(path / "bench.csv", columns)


def test_columns_with_the_symbols_of_a_train_make_one(tmp_path: Path) -> None:
    """Mutants killed: inertias in another order, a sign that is lost, a scale that is left free."""
    columns = ["a=t [s]", "b=i_motor [A]", "c=theta_motor [rad]", "d=-theta_load [rad]"]
    found = made(bench(tmp_path), columns=columns)
    assert found["model"] == {
        "name": "train",
        "inertias": ["motor", "load"],
        "shafts": {"shaft": ["motor", "load"]},
        "drives": {"motor": "current"},
    }
    assert told(found) == {"theta_motor": ("c", "rad"), "theta_load": ("d", "rad")}
    assert found["record"]["channels"]["theta_load"]["measures"] == "-theta_load"
    assert found["inputs"]["i_motor"]["column"] == "b"
    assert found["parameters"]["k_T_motor"] == 1.0
    assert found["initial"] == "free"
    accepted(tmp_path / "bench.yaml")


def test_positions_make_a_train_along_a_line(tmp_path: Path) -> None:
    columns = ["a=t [s]", "b=f_cart [N]", "c=x_cart [mm]", "d=v_end [mm/s]"]
    found = made(bench(tmp_path), columns=columns)
    assert found["model"]["motion"] == "linear"
    assert found["model"]["drives"] == {"cart": "torque"}
    assert found["inputs"]["f_cart"]["unit"] == "N"
    assert {"m_cart", "m_end", "k_shaft", "c_cart"} <= {*found["parameters"]}
    accepted(tmp_path / "bench.yaml")


def test_a_train_that_nothing_drives_has_no_inputs(tmp_path: Path) -> None:
    found = made(bench(tmp_path), columns=["a=t [s]", "c=theta_arm [rad]"])
    assert found["model"] == {"name": "train", "inertias": ["arm"]}
    assert found["inputs"] == {}
    accepted(tmp_path / "bench.yaml")


def test_a_symbol_of_another_rig_is_none_of_a_train(tmp_path: Path) -> None:
    columns = ["a=t [s]", "b=t_m [N*m]", "c=theta_2 [rad]"]
    assert made(bench(tmp_path), rig="motor", columns=columns)["model"]["name"] == "motor"
