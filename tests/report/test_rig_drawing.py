"""The drawing of a rig as it is rendered."""

from functools import cache

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from numpy.typing import NDArray
from support.case_tables import slow_except
from support.figure_checks import box, drawn, overlap, overlapping, shown

from bayesdrill.report.rig_drawing import rig_figure
from bayesdrill.rig.models.linear import Model, with_named
from bayesdrill.rig.models.motor_shaft import Motor, MotorShaft
from bayesdrill.rig.models.train import Train

DISCS = tuple(f"disc_{k}" for k in range(1, 7))
TRAINS: dict[str, Model] = {
    "six": Train(
        inertias=DISCS,
        shafts={f"s{k}": list(DISCS[k : k + 2]) for k in range(5)},
        drives={"disc_1": "current"},
    ),
    "gear": Train(
        inertias=("motor", "arm", "load"),
        gears={"box": {"between": ["motor", "arm"], "ratio": 0.07}},
        shafts={"coupling": ["arm", "load"], "spring": ["load", "ground"]},
        drives={"motor": "current"},
        gravity=("arm",),
    ),
    "linear": Train(
        inertias=("cart", "mass"),
        motion="linear",
        shafts={"wall": ["ground", "cart"], "link": ["cart", "mass"]},
        drives={"cart": "torque"},
    ),
    "branches": Train(
        inertias=("motor", "hub", "left", "a_part_with_a_long_name", "other"),
        shafts={
            "in": ["motor", "hub"],
            "beside": ["motor", "hub"],
            "out": ["hub", "left"],
            "down": ["hub", "a_part_with_a_long_name"],
            "loop": ["left", "other"],
            "back": ["other", "motor"],
        },
        drives={"motor": "speed"},
        rock=("left",),
    ),
    "servo": Train(inertias=("arm",), drives={"arm": "servo"}, gravity=("arm",)),
    "supplied": Train(
        inertias=("motor", "arm"),
        shafts={"link": ["motor", "arm"]},
        drives={"motor": {"servo": 12.0}},
    ),
    "paper": MotorShaft(),
    "motor": Motor(),
}


def full(rig: Model) -> Model:
    """With all that it offers, but friction at two inertias that turn as one."""
    twice = ("t_c_arm", "t_s_arm", "w_s_arm")
    return with_named(rig, [name for name in rig.offers if name not in twice])


PICTURES = {f"bare {name}": TRAINS[name] for name in ("gear", "branches", "paper")}
PICTURES |= {f"full {name}": full(rig) for name, rig in TRAINS.items()}
QUICK = ("bare paper", "bare branches", "full gear", "full linear", "full servo")
EVERY = slow_except(QUICK, PICTURES)


@cache
def picture(name: str) -> Figure:
    channels = ("theta_1", "w_1", "theta_2", "w_2") if name == "bare paper" else ()
    return drawn(rig_figure(PICTURES[name], channels))


def texts(figure: Figure) -> list[Text]:
    return shown(list(figure.axes[0].texts))


def framed(text: Text) -> Bbox:
    frame = text.get_bbox_patch()
    return box(text) if frame is None else frame.get_window_extent()


def arrows(figure: Figure) -> list[FancyArrowPatch]:
    return [p for p in figure.axes[0].patches if isinstance(p, FancyArrowPatch)]


def corners(arrow: FancyArrowPatch) -> NDArray[np.float64]:
    """Of the line and its head; the first is where the arrow starts."""
    path = arrow.get_path()
    vertices: NDArray[np.float64] = np.asarray(path.vertices, dtype=np.float64)
    kept: NDArray[np.float64] = vertices[np.asarray(path.codes) != Path.CLOSEPOLY]
    return kept


@pytest.mark.parametrize("name", EVERY)
def test_texts_are_apart_inside_the_page_and_off_the_lines(name: str) -> None:
    figure = picture(name)
    (sheet,) = figure.axes
    every = [(text.get_text(), framed(text)) for text in texts(figure)]
    both = [f"{every[k][0]} on {every[n][0]}" for k, n in overlapping([a for _, a in every])]
    assert not both
    lines = [line.get_path() for line in sheet.lines]
    lines += [Path(corners(arrow)) for arrow in arrows(figure)]
    lines = [sheet.transData.transform_path(line) for line in lines]
    edges = [p.get_window_extent() for p in sheet.patches if isinstance(p, Rectangle)]
    for text, a in every:
        assert figure.bbox.contains(*a.p0), text
        assert figure.bbox.contains(*a.p1), text
        for line in lines:
            assert not line.intersects_bbox(a, filled=False), text
        for edge in edges:
            inside = edge.contains(*a.p0) and edge.contains(*a.p1)
            assert inside or not overlap(a, edge), f"{text} on the edge of a box"


@pytest.mark.parametrize("name", EVERY)
def test_a_drawing_shows_each_part_of_a_rig_and_each_parameter(name: str) -> None:
    rig = PICTURES[name]
    shown = " ".join(text.get_text() for text in texts(picture(name)))
    for parameter in rig.parameters:
        assert shown.count(rig.symbols[parameter].latex) >= 1, (name, parameter)
    there = [i for i in rig.roles.inertias if i.inertia in rig.parameters]
    assert all(i.words.removeprefix("the ") in shown for i in there), name
    assert all(rig.symbols[n].latex in shown for n in rig.inputs), name


def test_the_rig_says_what_is_measured_and_by_how_much_it_is_geared() -> None:
    shown = [text.get_text() for text in texts(picture("bare paper"))]
    (note,) = (text for text in shown if text.startswith("measured: "))
    seen, unseen = note.split("; not measured: ")
    for k in (1, 2):
        assert rf"\theta_{k}" in seen.replace(r"\dot\theta", "")
        assert rf"\dot\theta_{k}" in seen
    assert unseen == r"$\dot q$"
    assert f"{1 / MotorShaft().i_m:g} : 1" in shown
