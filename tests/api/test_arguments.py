"""Every wrong argument of the API gives an `InputError` that names it, and no other exception."""

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
from support.array_cases import BOX, T, results, two
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.rig.models.drive_parts import Drive, Gear, Shaft

HUGE = 10**5000
CLOSED = io.StringIO()
CLOSED.close()
ENDLESS: dict[str, Any] = {}
ENDLESS["again"] = ENDLESS
NO_PATHS = ("", "a\0b", "~nobody_of_this_name/x", "x" * 5000)
POOL: tuple[Any, ...] = (
    *(None, object(), -1, 10**30, HUGE, 1.5, float("nan"), float("inf"), 1j, True, "x", b"x"),
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
LOADED_LATE = {"rig", "at", "best"}  # types that annotations do not name: see below
RIGS = ("DrivenShaft", "LongShaft", "Motor", "MotorShaft", "TwoRotors")
IN_USE = ("Channel", "Input", "Train", *RIGS)  # records that `case` and `respond` look at


def public_calls() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield functions, constructors and methods of all that the API hands out."""
    things = results()
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
    """Each parameter of each public call is given each wrong value; the error names it.

    All others are wrong too, so that no work is begun.
    """
    unnoticed, tried = [], 0
    for name, call in public_calls():
        signature = inspect.signature(call).parameters.values()
        parameters = [one for one in signature if one.kind is not one.VAR_KEYWORD]
        wrong = {parameter.name: object() for parameter in parameters}
        for parameter in parameters:
            for value in POOL if parameter.name not in LOADED_LATE else ():
                if may_stand(value, str(parameter.annotation)):
                    continue
                tried += 1
                try:
                    call(**wrong | {parameter.name: value})
                    answer = "no error"
                except bd.InputError as error:
                    if any(problem.place.startswith(parameter.name) for problem in error.problems):
                        continue
                    answer = str(error)
                except Exception as error:
                    answer = repr(error)
                kind = type(value).__name__
                unnoticed.append(f"{name}({parameter.name}={kind}): {answer[:80]}")
    assert not unnoticed
    assert tried > 2000


def message(call: Callable[..., Any], **arguments: Any) -> str:
    """Return what a call answers that must be wrong."""
    with pytest.raises(bd.InputError) as error:
        call(**arguments)
    return str(error.value)


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


@run_cases("value", WRONG)
def test_a_wrong_value_within_an_argument_is_named(value: object) -> None:
    """In columns, fields of channels and inputs, entries, constants of rigs, numbers of mappings."""
    fields = [one.name for one in dataclasses.fields(bd.Channel) if one.name != "values"]
    channel = dataclasses.replace(GOOD, values=value)
    assert "w_1" in message(bd.case, **CASE | {"channels": {"w_1": channel}})
    assert "v" in message(bd.case, **CASE | {"inputs": {"v": bd.Input(value, "V")}})
    all_wrong = {"w_1": bd.Channel(T, *[value] * len(fields))}
    assert "channels.w_1.unit" in message(bd.case, **CASE | {"channels": all_wrong})
    assert "inputs" in message(bd.case, **CASE | {"inputs": {"v": value}})
    assert "k_s" in message(bd.case, **CASE | {"parameters": CASE["parameters"] | {"k_s": value}})
    assert "sampler" in message(bd.case, **CASE, sampler={"ess": value})
    assert "t: " in message(bd.respond, **RESPONSE | {"t": value})
    for name, key in (("parameters", "k_s"), ("inputs", "v"), ("initial", "w_1")):
        wrong = {**RESPONSE.get(name, {}), key: value}
        assert f"{name}.{key}" in message(bd.respond, **RESPONSE | {name: wrong})
    assert "rig" in message(bd.respond, **RESPONSE | {"rig": value})
    for name in RIGS:
        kind = getattr(bd, name)
        for field in dataclasses.fields(kind):
            if field.name == "added" and isinstance(value, tuple):
                continue
            assert f"{field.name}: " in message(kind, **{field.name: value})
    for name in ("inertias", "shafts", "gears", "drives", "motion", "gravity", "rock"):
        nothing = isinstance(value, list | tuple | dict) and not value  # as good as none
        if not nothing and (name != "inertias" or not isinstance(value, list)):
            assert f"{name}: " in message(bd.Train, **{name: value})
    with pytest.raises(bd.InputError, match="give a result of find_map, not"):
        two().sample(value)  # type: ignore[arg-type]


NUMBERS: dict[str, tuple[Callable[..., Any], str, tuple[Any, ...]]] = {
    "seed": (lambda **x: two().sample(best=results()["Best"], **x), "seed", (-1, 2**64, HUGE)),
    "part": (lambda **x: results()["Best"].plot(**x), "part", (-1, 0, 2, HUGE)),
    "processes": (lambda **x: two().find_map(**x), "processes", (-1, 0, 10**9, HUGE)),
    "gear": (
        lambda **x: bd.init(record="nowhere.csv", **x), "gear", (math.nan, math.inf, 0.5, -1)
    ),
    "ratio": (bd.MotorShaft, "i_m", (math.nan, math.inf, 8, -1, HUGE)),
    "ratio of two rotors": (bd.TwoRotors, "i_m", (math.nan, math.inf, 8, -1, HUGE)),
    "elements": (bd.LongShaft, "elements", (2.5,)),
    "models of a ladder": (lambda **x: bd.ladder("nowhere.yaml", **x), "sample", (-1, 1, 10**9)),
    "files of a draft": (bd.init, "record", ([],)),
}  # fmt: skip


@run_cases("call, name, values", NUMBERS.values(), NUMBERS)
def test_a_number_out_of_range_is_refused(
    call: Callable[..., Any], name: str, values: tuple[Any, ...]
) -> None:
    for value in values:
        assert f"{name}: " in message(call, **{name: value})


TWO_ENDS = ("motor", "load")
WRONG_PARTS: dict[str, tuple[str, Any]] = {
    "an end that is a number": ("shafts", (Shaft("s", 5),)),  # type: ignore[arg-type]
    "an end that is a list": ("shafts", (Shaft("s", (["motor"], "load")),)),  # type: ignore[arg-type]
    "a name that is a number": ("shafts", (Shaft(3, TWO_ENDS),)),  # type: ignore[arg-type]
    "two of one name": ("inertias", (Shaft("s", TWO_ENDS), Shaft("s", TWO_ENDS))),
    "a ratio beyond all numbers": ("gears", (Gear("g", TWO_ENDS, 10**400),)),
    "a ratio that is none": ("gears", (Gear("g", TWO_ENDS, math.nan),)),
    "a huge ratio": ("gears", {"g": {"between": TWO_ENDS, "ratio": HUGE}}),
    "a drive that is a list": ("drives", (Drive("motor", []),)),  # type: ignore[arg-type]
    "a drive of a number": ("drives", (Drive(5, "speed"),)),  # type: ignore[arg-type]
    "a list of additions": ("added", ["c_motor"]),
    "a part that is added": ("added", (Shaft("s", (["motor"], "load")),)),  # type: ignore[arg-type]
    "an unknown addition": ("added", ("c_moter",)),
    "another motion": ("motion", "around"),
    "a power of three": ("stribeck", 3),
}


@run_cases("place, value", WRONG_PARTS.values(), WRONG_PARTS)
def test_a_train_refuses_wrong_parts(place: str, value: Any) -> None:
    entry = "shafts" if place == "inertias" else place
    assert f"{place}: " in message(bd.Train, inertias=TWO_ENDS, **{entry: value})


def test_all_mistakes_are_named_at_once_in_plain_words() -> None:
    text = message(bd.case, t=T, channels=3, inputs={"v": 5.0}, parameters=["k_s"], name=b"x")
    assert text.splitlines() == [
        "channels: give a bd.Channel(values, unit, sigma) for each name, not int",
        "parameters: give a prior, a number or 'nominal' for each name, not list",
        "name: give a text, not bytes",
    ]
    assert message(bd.MotorShaft, i_m="x", stribeck=3).count(" is refused: ") == 2
    assert message(bd.compare, runs=["a", 3]) == "runs, number 2: give a Run or a path, not int"
    assert "an object that has say and update" in message(two().identify, report=print)
    assert "signals" in message(bd.respond, **RESPONSE | {"signals": []})
