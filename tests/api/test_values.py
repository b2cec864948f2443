"""What the API hands out goes to other processes, and is the same there."""

from __future__ import annotations

import dataclasses
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
import pytest
from support.array_cases import T, noisy, run, two
from support.case_tables import run_cases
from support.command_line import ROOT

import bayesdrill as bd
from bayesdrill.basics.values import equal_content
from bayesdrill.rig.kernels.compiling import compile_kernel

CONFIGS = ROOT / "configs"


def things() -> dict[str, Any]:
    config = CONFIGS / "nominal_step.yaml"
    return {
        "case": two(),
        "best": bd.Best(run().job, run().mode, run().columns),
        "run": run(),
        "judged": run().judge(),
        "findings": two().identify(),
        "verdict": run().judge().verdict,
        "overlay": bd.overlay([run(), run()]),
        "comparison": bd.compare([run(), dataclasses.replace(run())]),
        "ladder": bd.ladder(config),
        "calibration": bd.calibration(config),
        "channel": noisy("w_1", 1.0, 0.1),
        "input": bd.Input([1.0, float("nan")], "V"),
    }


def compiled() -> int:
    return compile_kernel.cache_info().misses


def test_what_is_handed_out_can_be_pickled_and_is_the_same_after() -> None:
    """Twice over, for what it has computed meanwhile is no part of it; nothing is compiled for that."""
    for name, thing in things().items():
        packed, before = pickle.dumps(thing), compiled()
        back = pickle.loads(packed)
        assert compiled() == before, name
        assert back is not thing, name
        assert back == thing, name
        assert hash(back) == hash(thing), name
        if name in ("case", "best", "judged"):
            assert str(back) == str(thing), name
        assert pickle.loads(pickle.dumps(back)) == thing, name


def test_what_is_computed_stays_here() -> None:
    """A run that was judged is as short as one that was not."""
    judged = dataclasses.replace(run())
    assert judged.judge().text
    assert len(pickle.dumps(judged)) == len(pickle.dumps(dataclasses.replace(run())))


@run_cases("name", ["nominal_step", "example_experiments", "example_torque"])
def test_a_case_that_is_read_again_is_the_same(name: str) -> None:
    """Of several experiments, of rigs that rub and of those that a torque shakes too."""
    case = bd.load(CONFIGS / f"{name}.yaml")
    theta = case.job.problem.posterior.space.draw(4, np.random.default_rng(5))
    back = pickle.loads(pickle.dumps(case))
    assert back == case == bd.load(CONFIGS / f"{name}.yaml")
    one, other = (of.job.problem.posterior.density(theta) for of in (case, back))
    assert np.array_equal(one, other)


def test_what_differs_in_one_thing_is_another() -> None:
    """A sample, a seed, a prior, a draw: each alone."""
    case, moved = two(), noisy("w_1", 1.0, 0.1)
    moved = dataclasses.replace(moved, values=np.where(T[7] == T, 1e-9, 0.0) + moved.values)
    channels = {"theta_2": noisy("theta_2", np.pi / 180, 0.05), "w_1": moved}
    assert two() == case
    assert two(seed=5) != case
    assert two(initial={"w_1": 1e-9}) != case
    assert two(channels=channels) != case
    draws = np.copy(run().sampled.theta)
    draws[0, 0, 0, 0] = np.nextafter(draws[0, 0, 0, 0], 1.0)
    sampled = dataclasses.replace(run().sampled, theta=draws)
    assert dataclasses.replace(run(), sampled=sampled) != run()
    assert dataclasses.replace(run()) == run()
    assert run() != run().judge()
    assert case != 3


def test_alike_looks_into_what_has_no_equality_of_its_own() -> None:
    nothing = float("nan")
    assert equal_content({"a": [np.array([1.0, nothing])]}, {"a": [np.array([1.0, nothing])]})
    assert equal_content(nothing, -nothing)
    assert not equal_content(np.zeros(2), np.zeros(2, int))
    assert not equal_content(np.zeros(2), np.zeros((2, 1)))
    assert not equal_content([1, 2], (1, 2))
    assert not equal_content({"a": 1}, {"a": 1, "b": 2})
    assert not equal_content([1], [1, 2])
    assert not equal_content(len, max)
    assert not equal_content(int, float)


def test_a_mistake_comes_back_from_another_process_as_it_was() -> None:
    with pytest.raises(bd.InputError) as told:
        bd.case(T, {}, {"v": "x"}, {})
    back = pickle.loads(pickle.dumps(told.value))
    assert str(back) == str(told.value)
    assert back.problems == told.value.problems


def _found(case: bd.Case) -> tuple[bd.Case, bd.Best]:
    return case, case.find_map()


def test_a_process_that_is_spawned_finds_the_same_maximum() -> None:
    """Of which the first process samples: it is the maximum of its own case."""
    case = two()
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn) as pool:
        back, best = pool.submit(_found, case).result()
    assert back == case
    assert best == bd.Best(run().job, run().mode, run().columns)
    assert case.identify(at=best).study.at == "the MAP"
