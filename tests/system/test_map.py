"""`bayesdrill map CONFIG`: the maximum of the posterior, what it predicts, and why a fit is bad."""

import csv
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support import command_line
from support.command_line import assert_refused, cli
from support.scipy_oracles import NOMINAL, by_expm
from support.unexplained_records import try_only

import bayesdrill as bd
from bayesdrill.output_files import loads_checksummed
from bayesdrill.rig.models.motor_shaft import MotorShaft

Array = NDArray[np.float64]

T = np.linspace(0.0, 4.0, 161)
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
WRONG_UNIT = ("w_1, unit: rad/s", "w_1, unit: rpm")
FILES = {
    *("config.yaml", "config.resolved.yaml", "map.json", "map.csv", "map.md", "prediction.csv"),
    *("report.html", "run.json", "figures", "figures/fit.pdf", "figures/fit.png", ".lock"),
}


@cache
def best() -> bd.Best:
    """The maximum of a twist in degrees and a speed in rpm, at 6000 mV."""
    signals = ["theta_1 - theta_2", "w_2"]
    exact = bd.respond(MotorShaft(), NOMINAL, T, {"v": 6.0}, signals)
    noise = np.random.default_rng(3).standard_normal((2, len(T)))
    twist = np.degrees(exact[signals[0]]) + noise[0]
    speed = exact["w_2"] * 30 / np.pi + noise[1]
    case = bd.case(
        T,
        {
            "twist": bd.Channel(twist, "deg", 1.0, measures=signals[0]),
            "w_2": bd.Channel(speed, "rpm", 1.0),
        },
        {"v": bd.Input(np.full(len(T), 6000.0), "mV")},
        dict.fromkeys(NOMINAL, "nominal") | {"k_s": BOX, "k_e": BOX},
        map={"starts": 1},
    )
    return case.find_map()


def columns(path: Path) -> dict[str, Array]:
    with path.open(encoding="utf-8") as file:
        head, *lines = csv.reader(file)
    return dict(zip(head, np.array(lines, dtype=float).T, strict=True))


def test_the_prediction_is_the_response_in_the_units_of_the_record(tmp_path: Path) -> None:
    """Oracle: the matrix exponential at the values of the maximum."""
    table = columns(best().save(tmp_path / "out") / "prediction.csv")
    assert list(table) == [
        *("t [s]", "twist measured [deg]", "twist predicted [deg]", "w_2 measured [rpm]"),
        *("w_2 predicted [rpm]", "t_1 [N*m]", "v [mV]"),
    ]
    x = by_expm({**NOMINAL, **best().values}, T, np.zeros(5), 6.0, 0.0)
    twist, speed = np.degrees(x[:, 0] - x[:, 1]), x[:, 3] * 30 / np.pi
    assert table["twist predicted [deg]"] == pytest.approx(twist, rel=1e-7, abs=1e-7)
    assert table["w_2 predicted [rpm]"] == pytest.approx(speed, rel=1e-7, abs=1e-7)
    assert table["t [s]"] == pytest.approx(T)
    assert (table["v [mV]"] == 6000.0).all()
    given = best().columns
    assert given is not None
    for name, unit in (("twist", "deg"), ("w_2", "rpm")):
        measured = table[f"{name} measured [{unit}]"]
        assert measured == pytest.approx(given[name], rel=1e-11)
        residuals = measured - table[f"{name} predicted [{unit}]"]
        assert residuals.std() == pytest.approx(1.0, abs=0.2)


def test_a_maximum_of_arrays_is_kept_with_its_record(tmp_path: Path) -> None:
    out = best().save(tmp_path / "out")
    assert set(command_line.listing(out)) == FILES | {"record.csv"}
    assert bd.verify(out).together
    again = bd.load(out / "config.yaml").find_map()
    assert again.values == pytest.approx(best().values, rel=1e-6)
    rows = command_line.table(out / "map.csv")
    assert {name: float(row["map"]) for name, row in rows.items()} == dict(best().values)
    assert float(rows["k_s"]["nominal"]) == NOMINAL["k_s"]
    assert loads_checksummed((out / "map.json").read_bytes())["values"] == dict(best().values)


def test_a_map_is_written_on_request_and_a_missing_file_of_it_made_again(tmp_path: Path) -> None:
    config, out = command_line.small_config(tmp_path), tmp_path / "out"
    before = command_line.listing(tmp_path)
    result = cli("map", config, "--processes", "1")
    assert result.status == 0
    assert "k_e" in result.out
    assert command_line.listing(tmp_path) == before
    command = ("map", config, "--output", out, "--processes", "1")
    result = cli(*command)
    assert result.status == 0, result.text
    assert set(command_line.listing(out)) == FILES
    assert f"results: {out}/" in result.out
    (out / "map.csv").unlink()
    assert_refused(cli("verify", out), "`bayesdrill map --force` makes it again")
    assert cli(*command, "--force").status == 0
    assert cli("verify", out).status == 0


def test_a_fit_that_must_not_be_believed_ends_with_status_3(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As its posterior does; the report says so before it describes the fit."""
    try_only({"offset_w_1"}, monkeypatch)
    config, out = command_line.small_config(tmp_path, WRONG_UNIT), tmp_path / "out"
    result = cli("map", config, "--quick", "--output", out, "--processes", "1")
    assert result.status == 3
    assert result.out.index("DO NOT BELIEVE these numbers:") > result.out.index("fit: ")
    assert "fit: the residuals are larger than the noise: w_1 " in result.out
    assert "look like" not in result.out
    page = (out / "map.md").read_text()
    assert page.index("DO NOT BELIEVE these numbers:") < page.index("fit: ")
    maximum = bd.load(config).find_map(quick=True)
    assert maximum.reasons[0].startswith("the residuals are larger than the noise: w_1 ")
    assert loads_checksummed((out / "run.json").read_bytes())["reasons"] == list(maximum.reasons)
    assert best().reasons == ()
    assert "BELIEVE" not in best().table


@pytest.mark.slow
def test_a_prior_that_ends_too_early_is_widened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the config that `--apply` writes fits."""
    try_only({"prior_j_1", "gain_theta_1", "offset_w_1", "damping_rotor_1"}, monkeypatch)
    early = ("1.5, relative: true}\n  t_f", "0.8, relative: true, start: 0.02}\n  t_f")
    path, new = command_line.small_config(tmp_path, early), tmp_path / "new.yaml"
    result = cli("map", path, "--processes", "1", "--apply", new)
    (line,) = [x for x in result.out.splitlines() if x.startswith("fit: A is the config with ")]
    assert line == "fit: A is the config with a wider prior of j_1."
    assert "prior: j_1 is at an end of its prior" in result.out
    again = cli("map", new, "--processes", "1")
    assert "the residuals look like the noise" in again.out
    assert again.status == 0


def test_apply_writes_a_new_config_and_never_over_another_file(tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path)
    before = command_line.listing(tmp_path)
    other, new = tmp_path / "there.yaml", tmp_path / "new.yaml"
    other.write_text("mine: 1\n")
    for target, message in (
        (config, "is the given config"),
        (tmp_path / "small.csv", "a config is a .yaml file"),
        (other, "exists already"),
        (tmp_path / "no" / "new.yaml", "this folder does not exist"),
    ):
        assert_refused(cli("map", config, "--processes", "1", "--apply", target), message)
    assert cli("map", config, "--quick", "--apply", new).status == 2
    other.unlink()
    result = cli("map", config, "--processes", "1", "--apply", new)
    assert result.status == 0
    assert "nothing to write: the residuals look like the noise" in result.out
    assert command_line.listing(tmp_path) == before
