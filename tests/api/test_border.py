"""Whatever the API is given: `InputError` where it is wrong, and no other exception."""

from __future__ import annotations

import dataclasses
import datetime
import inspect
import io
import math
import re
from collections.abc import Callable, Iterator
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.array_cases import BOX, T, run, two
from support.case_tables import for_each, run_cases
from support.command_line import ROOT
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.api.comparison import Overlay
from bayesdrill.rig.models.drive_parts import Drive, Gear, Shaft

CONFIG = ROOT / "configs" / "nominal_step.yaml"
CLOSED = io.StringIO()
CLOSED.close()
ENDLESS: dict[str, Any] = {}
ENDLESS["again"] = ENDLESS
NO_PATHS = ("", "a\0b", "~nobody_of_this_name/x", "x" * 5000)
POOL: tuple[Any, ...] = (
    *(None, object(), -1, 10**30, 10**5000, 1.5, float("nan"), float("inf"), 1j, True, "x", b"x"),
    *(*NO_PATHS, [], [1], ["x"], [[1, 2], [3]], (), {}, {1: 2}, {"x": 1}, ENDLESS, set()),
    *(np.zeros(3), np.zeros((2, 2)), np.zeros(2, complex), np.array(["a"]), np.float64("nan")),
    *(np.int64(3), np.datetime64("2026-01-01"), datetime.datetime(2026, 1, 1), CLOSED, len, int),
    *(Path("nowhere"), slice(3), (i for i in range(3))),
)
# What may stand where an annotation names it.
KINDS: dict[str, Callable[[Any], bool]] = {
    "None": lambda value: value is None,
    "bool": lambda value: isinstance(value, bool),
    "int": lambda value: isinstance(value, Integral) and not isinstance(value, bool),
    "float": lambda value: isinstance(value, Real) and not isinstance(value, bool),
    "str": lambda value: isinstance(value, str),
    "Path": lambda value: isinstance(value, Path),
    "Mapping": lambda value: isinstance(value, dict) and all(isinstance(n, str) for n in value),
    "Sequence": lambda value: isinstance(value, list | tuple) and {*map(type, value)} <= {str},
    "tuple": lambda value: isinstance(value, tuple),
    "ArrayLike": lambda _: True,  # `case` and `respond` look at it: see below
    "Any": lambda _: True,
}
BY_HAND = {"rig", "at", "best"}  # types of these are loaded late: see below
RIGS = ("DrivenShaft", "LongShaft", "Motor", "MotorShaft", "TwoRotors")
IN_USE = ("Channel", "Input", "Train", *RIGS)  # records that `case` and `respond` look at


def calls() -> Iterator[tuple[str, Callable[..., Any]]]:
    """All that is public: functions, and constructors and methods of all that is handed out."""
    case = two()
    things = {
        "Case": case,
        "Best": bd.Best(run().job, run().mode),
        "Run": run(),
        "RunReport": run().judge(),
        "Findings": case.identify(),
        "Verdict": run().judge().verdict,
        "Overlay": bd.overlay([run(), run()]),
        "Comparison": bd.compare([run(), dataclasses.replace(run())]),
        "Ladder": bd.ladder(CONFIG),
        "Calibration": bd.calibration(CONFIG),
    }
    for name in bd.__all__:
        if inspect.isfunction(getattr(bd, name)):
            yield name, getattr(bd, name)
        else:
            known = (*things, *IN_USE, "InputError", "__version__")
            assert name in known, f"{name} is public, and nobody looks at it here"
    for name, thing in things.items():
        if name in bd.__all__:
            yield name, type(thing)
        for method, _ in inspect.getmembers(type(thing), inspect.isroutine):
            if not method.startswith("_"):
                yield f"{name}.{method}", getattr(thing, method)


def may_stand(value: Any, annotation: str) -> bool:
    plain = re.sub(r"^Annotated\[(.*), [^\]]*\]$", r"\1", annotation)
    kinds = re.sub(r"\[.*?\](?!\])", "", plain).split(" | ")
    if "Path" in kinds and isinstance(value, str) and value in NO_PATHS:
        return False
    return any(kind in KINDS and KINDS[kind](value) for kind in kinds)


def test_no_call_takes_what_its_annotations_do_not_name() -> None:
    """Every parameter of all that is public is given each wrong value; the mistake has its name.

    All others are wrong too, so that nothing is begun.
    """
    astray, tried = [], 0
    for name, call in calls():
        every = inspect.signature(call).parameters.values()
        parameters = [one for one in every if one.kind is not one.VAR_KEYWORD]
        wrong = {one.name: object() for one in parameters}
        for one in parameters:
            for value in POOL if one.name not in BY_HAND else ():
                if may_stand(value, str(one.annotation)):
                    continue
                tried += 1
                try:
                    call(**wrong | {one.name: value})
                except bd.InputError as error:
                    if any(problem.place.startswith(one.name) for problem in error.problems):
                        continue
                    answer = str(error)
                except Exception as error:
                    answer = repr(error)
                else:
                    answer = "nothing is wrong"
                astray.append(f"{name}({one.name}={type(value).__name__}): {answer[:80]}")
    assert not astray
    assert tried > 2000


def refused(call: Callable[..., Any], **arguments: Any) -> str:
    """What a call says that must be wrong."""
    with pytest.raises(bd.InputError) as told:
        call(**arguments)
    return str(told.value)


GOOD = bd.Channel(np.sin(T), "rad/s", 0.1)
CASE: dict[str, Any] = {
    "t": T,
    "channels": {"w_1": GOOD},
    "inputs": {"v": 5.0},
    "parameters": dict.fromkeys(NOMINAL, BOX),
}
RESPONSE: dict[str, Any] = {
    "rig": "motor_shaft",
    "parameters": NOMINAL,
    "t": T,
    "inputs": {"v": 5.0},
    "signals": ["w_1"],
}
WRONG = [value for value in POOL if not isinstance(value, int | float | str | np.int64 | None)]


@run_cases("value", [one for k, one in enumerate(WRONG)])
def test_what_stands_in_records_is_judged_where_they_are_used(value: object) -> None:
    """Columns, fields of channels and inputs, entries, constants of rigs, numbers of mappings."""
    fields = [one.name for one in dataclasses.fields(bd.Channel) if one.name != "values"]
    channel = dataclasses.replace(GOOD, values=value)
    assert "w_1" in refused(bd.case, **CASE | {"channels": {"w_1": channel}})
    assert "v" in refused(bd.case, **CASE | {"inputs": {"v": bd.Input(value, "V")}})
    told = refused(bd.case, **CASE | {"channels": {"w_1": bd.Channel(T, *[value] * len(fields))}})
    assert "channels.w_1.unit" in told
    assert "inputs" in refused(bd.case, **CASE | {"inputs": {"v": value}})
    assert "k_s" in refused(bd.case, **CASE | {"parameters": CASE["parameters"] | {"k_s": value}})
    assert "sampler" in refused(bd.case, **CASE, sampler={"ess": value})
    assert "t: " in refused(bd.respond, **RESPONSE | {"t": value})
    for name, key in (("parameters", "k_s"), ("inputs", "v"), ("initial", "w_1")):
        wrong = {**RESPONSE.get(name, {}), key: value}
        assert f"{name}.{key}" in refused(bd.respond, **RESPONSE | {name: wrong})
    assert "rig" in refused(bd.respond, **RESPONSE | {"rig": value})
    for name in RIGS:
        kind = getattr(bd, name)
        for field in dataclasses.fields(kind):
            if field.name == "added" and isinstance(value, tuple):
                continue
            assert f"{field.name}: " in refused(kind, **{field.name: value})
    for name in ("inertias", "shafts", "gears", "drives", "motion", "gravity", "rock"):
        nothing = isinstance(value, list | tuple | dict) and not value  # as good as none
        if not nothing and (name != "inertias" or not isinstance(value, list)):
            assert f"{name}: " in refused(bd.Train, **{name: value})
    with pytest.raises(bd.InputError, match="give what find_map found"):
        two().sample(value)  # type: ignore[arg-type]


def test_numbers_of_no_use_are_refused() -> None:
    """Of the right kind all of them."""
    best = bd.Best(run().job, run().mode)
    huge = 10**5000
    for seed in (-1, 2**64, huge):
        assert "seed" in refused(two().sample, best=best, seed=seed)
    for part in (-1, 0, 2, huge):
        assert "part" in refused(best.plot, part=part)
    for processes in (-1, 0, huge):
        assert "processes" in refused(two().find_map, processes=processes)
    for gear in (float("nan"), float("inf"), 0.5, -1):
        assert "gear" in refused(bd.init, record="nowhere.csv", gear=gear)
    for gear in (float("nan"), float("inf"), 8, -1, huge):
        assert "i_m: " in refused(bd.MotorShaft, i_m=gear)
        assert "i_m: " in refused(bd.TwoRotors, i_m=gear)
    assert "signals" in refused(bd.respond, **RESPONSE | {"signals": []})
    assert refused(bd.MotorShaft, i_m="x", stribeck=3).count(" cannot be this") == 2
    assert "elements: " in refused(bd.LongShaft, elements=2.5)
    assert bd.Motor(i_m=np.float64(0.25)) == bd.Motor(i_m=0.25)


def test_a_train_refuses_every_wrong_argument() -> None:
    """Also parts that a caller has made, as a train shows them: texts, lists and numbers in them."""
    two_ends = ("motor", "load")
    cases: dict[str, tuple[str, Any]] = {
        "an end that is a number": ("shafts", (Shaft("s", 5),)),  # type: ignore[arg-type]
        "an end that is a list": ("shafts", (Shaft("s", (["motor"], "load")),)),  # type: ignore[arg-type]
        "a name that is a number": ("shafts", (Shaft(3, two_ends),)),  # type: ignore[arg-type]
        "two of one name": ("shafts", (Shaft("s", two_ends), Shaft("s", two_ends))),
        "a ratio beyond all numbers": ("gears", (Gear("g", two_ends, 10**400),)),
        "a ratio that is none": ("gears", (Gear("g", two_ends, math.nan),)),
        "a huge ratio": ("gears", {"g": {"between": two_ends, "ratio": 10**5000}}),
        "a drive that is a list": ("drives", (Drive("motor", []),)),  # type: ignore[arg-type]
        "a drive of a number": ("drives", (Drive(5, "speed"),)),  # type: ignore[arg-type]
        "what is added is a list": ("added", ["c_motor"]),
        "a part that is added": ("added", (Shaft("s", (["motor"], "load")),)),  # type: ignore[arg-type]
        "what it has not": ("added", ("c_moter",)),
        "another motion": ("motion", "around"),
        "a power of three": ("stribeck", 3),
    }

    def check(entry: str, value: Any) -> None:
        place = "inertias: " if value == cases["two of one name"][1] else f"{entry}: "
        assert place in refused(bd.Train, inertias=two_ends, **{entry: value})

    for_each(cases, check)
    made = bd.Train(inertias=two_ends, shafts={"s": two_ends}, gears={}, drives={"motor": "speed"})
    assert dataclasses.replace(made, motion="linear").shafts == made.shafts


def test_all_that_is_wrong_is_said_at_once_in_words_of_its_own() -> None:
    told = refused(bd.case, t=T, channels=3, inputs={"v": 5.0}, parameters=["k_s"], name=b"x")
    assert told.splitlines() == [
        "channels: give a bd.Channel(values, unit, sigma) for each name, not int",
        "parameters: give a prior, a number or 'nominal' for each name, not list",
        "name: give a text, not bytes",
    ]
    assert refused(bd.compare, runs=["a", 3]) == "runs, number 2: give a Run or a path, not int"
    assert "an object that has say and update" in refused(two().identify, report=print)


def test_numbers_and_words_of_numpy_are_numbers_and_words() -> None:
    one = run().plot(np.str_("corner"), part=np.int64(1))
    assert one.axes
    assert isinstance(bd.overlay((run(), run()), names=[np.str_("a"), "b"]), Overlay)
