"""A maximum that is kept: what it predicts in the units of the record, its fit, and whose it is."""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.typing import NDArray
from support import command_line
from support.figure_checks import clashes, drawn
from support.scipy_oracles import NOMINAL, by_expm

import bayesdrill as bd
from bayesdrill.output_files import loads_checksummed
from bayesdrill.rig.models.motor_shaft import MotorShaft

Array = NDArray[np.float64]

T = np.linspace(0.0, 4.0, 161)
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
WRONG = (
    "w_1: {column: w_1, unit: rad/s, sigma: 0.05}",
    "w_1: {column: w_1, unit: rpm, sigma: 0.05}",
)
FILES = {
    *("config.yaml", "config.resolved.yaml", "map.json", "map.csv", "map.md", "prediction.csv"),
    "report.html",
    *("run.json", "figures", "figures/fit.pdf", "figures/fit.png", ".lock"),
}


@cache
def best() -> bd.Best:
    """Of a twist in degrees and a speed in rpm, at 6000 mV."""
    signals = ["theta_1 - theta_2", "w_1"]
    exact = bd.respond(MotorShaft(), NOMINAL, T, {"v": 6.0}, signals)
    noise = np.random.default_rng(3).standard_normal((2, len(T)))
    twist = np.degrees(exact[signals[0]]) + noise[0]
    speed = exact["w_1"] * 30 / np.pi + noise[1]
    case = bd.case(
        T,
        {
            "twist": bd.Channel(twist, "deg", 1.0, measures=signals[0]),
            "w_1": bd.Channel(speed, "rpm", 1.0),
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
    found = columns(best().save(tmp_path / "out") / "prediction.csv")
    assert list(found) == [
        *("t [s]", "twist measured [deg]", "twist predicted [deg]", "w_1 measured [rpm]"),
        *("w_1 predicted [rpm]", "t_1 [N*m]", "v [mV]"),
    ]
    x = by_expm({**NOMINAL, **best().values}, T, np.zeros(5), 6.0, 0.0)
    assert found["twist predicted [deg]"] == pytest.approx(
        np.degrees(x[:, 0] - x[:, 1]), rel=1e-7, abs=1e-7
    )
    assert found["w_1 predicted [rpm]"] == pytest.approx(x[:, 2] * 30 / np.pi, rel=1e-7, abs=1e-7)
    assert found["t [s]"] == pytest.approx(T)
    assert (found["v [mV]"] == 6000.0).all()
    given = best().columns
    assert given is not None
    for name, unit in (("twist", "deg"), ("w_1", "rpm")):
        assert found[f"{name} measured [{unit}]"] == pytest.approx(given[name], rel=1e-11)
        left = found[f"{name} measured [{unit}]"] - found[f"{name} predicted [{unit}]"]
        assert left.std() == pytest.approx(1.0, abs=0.2)


def test_a_maximum_of_arrays_is_kept_with_its_record(tmp_path: Path) -> None:
    out = best().save(tmp_path / "out")
    assert set(command_line.listing(out)) == FILES | {"record.csv"}
    assert bd.verify(out).together
    again = bd.load(out / "config.yaml").find_map()
    assert again.values == pytest.approx(best().values, rel=1e-6)
    with (out / "map.csv").open(encoding="utf-8") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    assert {name: float(row["map"]) for name, row in rows.items()} == dict(best().values)
    assert float(rows["k_s"]["nominal"]) == NOMINAL["k_s"]
    assert loads_checksummed((out / "map.json").read_bytes())["values"] == dict(best().values)


def test_the_fit_is_drawn(tmp_path: Path) -> None:
    figure = best().plot()
    assert isinstance(figure, Figure)
    assert list(clashes(drawn(figure))) == []
    legends = [legend for panel in figure.axes if (legend := panel.get_legend()) is not None]
    texts = [text.get_text() for legend in legends for text in legend.get_texts()]
    assert not any("predictive" in text for text in texts)
    assert sum("of the noise" in text for text in texts) == 2  # about the model, and about nothing


@pytest.fixture
def config(tmp_path: Path) -> Path:
    return command_line.small_config(tmp_path)


def test_map_writes_where_it_is_told_and_overwrites_nothing_unasked(config: Path) -> None:
    place, out = config.parent, config.parent / "out"
    before = command_line.listing(place)
    ran = command_line.cli("map", config, "--processes", "1")
    assert ran.status == 0
    assert "k_e" in ran.out
    assert command_line.listing(place) == before  # as it always was
    ran = command_line.cli("map", config, "--output", out, "--processes", "1")
    assert ran.status == 0, ran.text
    assert set(command_line.listing(out)) == FILES
    assert f"results: {out}/" in ran.out
    (out / "notes.md").write_text("mine")
    before = command_line.listing(place)
    ran = command_line.cli("map", config, "--output", out, "--processes", "1")
    assert ran.status == 2
    assert "results exist already; make them anew with --force" in ran.err
    assert "MAP" not in ran.out  # before any search
    assert command_line.cli("map", config, "--output", place).status == 2  # where the record lies
    assert command_line.cli("posterior", config, "--output", out, "--force").status == 2
    assert command_line.listing(place) == before
    (out / "prediction.csv").write_text("old")
    ran = command_line.cli("map", config, "--output", out, "--force", "--processes", "1")
    assert ran.status == 0, ran.text
    assert (out / "notes.md").read_text() == "mine"
    assert (out / "prediction.csv").read_text().startswith("t [s],theta_1 measured [rad]")


def test_what_does_not_belong_to_a_maximum_is_named(config: Path) -> None:
    out = config.parent / "out"
    assert command_line.cli("map", config, "--output", out, "--processes", "1").status == 0
    assert "belong together" in command_line.cli("verify", out).out
    text = (out / "prediction.csv").read_text()
    first, second, rest = text.split("\n", 2)
    (out / "prediction.csv").write_text("\n".join([first, second.replace("0,", "0.1,", 1), rest]))
    assert "prediction.csv: was changed" in command_line.cli("verify", out).err
    (out / "prediction.csv").write_text(text)
    lines = (config.parent / "small.csv").read_text().splitlines()
    lines[50] = lines[50].rsplit(",", 1)[0] + ",9.9"
    (config.parent / "small.csv").write_text("\n".join(lines) + "\n")
    assert "the record was 101 samples" in command_line.cli("verify", out).err


def test_a_fit_that_must_not_be_believed_ends_as_its_posterior_does(tmp_path: Path) -> None:
    """Mutant killed: status 0 of a fit that leaves far more than the noise."""
    config, out = command_line.small_config(tmp_path, WRONG), tmp_path / "out"
    ran = command_line.cli("map", config, "--quick", "--output", out, "--processes", "1")
    assert ran.status == 3
    assert ran.out.index("DO NOT BELIEVE these numbers:") > ran.out.index("fit: ")
    page = (out / "map.md").read_text()
    assert page.index("DO NOT BELIEVE these numbers:") < page.index("fit: ")
    found = bd.load(config).find_map(quick=True)
    assert found.reasons[0].startswith("the residuals are larger than the noise: w_1 ")
    assert loads_checksummed((out / "run.json").read_bytes())["reasons"] == list(found.reasons)
    assert best().reasons == ()
    assert "BELIEVE" not in best().table


@pytest.mark.slow
def test_a_fit_that_no_posterior_can_mend_is_said_before_anything_is_sampled(
    tmp_path: Path,
) -> None:
    """Mutant killed: the MAP is said, and what it leaves only after sampling."""
    for name, changes, said in (("sound", (), False), ("wrong", (WRONG,), True)):
        config = command_line.small_config(tmp_path / name, *changes)
        ran = command_line.cli("map", config)
        assert ("DO NOT BELIEVE these numbers" in ran.text) is said
        if said:
            before = ran.text[: ran.text.index("DO NOT BELIEVE")]
            assert "the residuals are larger than the noise: " in before
