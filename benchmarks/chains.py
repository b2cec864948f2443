"""What an evaluation costs as a chain of inertias grows.

`BAYESDRILL_CACHE=off python -m benchmarks.chains` prints a table: 1001 samples of four channels under
a sampled torque, batch of 64, one core.  Slopes are normal equations, by direction.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable

import numpy as np
import scipy.linalg

from bayesdrill.record.experiment import Channel, Experiment
from bayesdrill.rig.models.linear import constant_forcing, dynamics
from bayesdrill.rig.models.train import Train
from bayesdrill.rig.simulators.linear import Response

BATCH, STEP, SAMPLES = 64, 0.002, 1001
SIZES = (2, 5, 6, 10, 20, 40)  # inertias
USUAL = {"j": 0.01, "k": 30.0, "c": 0.02}


def chain(count: int) -> Train:
    names = [f"d{k}" for k in range(count)]
    shafts = {f"s{k}": pair for k, pair in enumerate(itertools.pairwise(names))}
    added = (*(f"c_{name}" for name in shafts), "c_d0")
    return Train(inertias=names, shafts=shafts, drives={"d0": "torque"}, added=added)


def record(model: Train) -> Experiment:
    shown = [model.states[k] for k in np.linspace(0, len(model.states) - 1, 4).astype(int)]
    torque = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], SAMPLES // 20 + 1), 20)
    return Experiment(
        t=STEP * np.arange(SAMPLES), y=np.zeros((SAMPLES, 4)),
        channels=tuple(
            Channel(name=name, weights={name: 1.0}, unit="1", latex=name, latex_unit="1")
            for name in shown
        ),
        constant={}, series={"t_d0": torque[:SAMPLES]}, first_order=False, start={}, t_start=0.0,
    )  # fmt: skip


def reference(model: Train, experiment: Experiment, row: np.ndarray) -> np.ndarray:
    """Channels (T, K) of one walker, by SciPy's exponential."""
    linear, x = model.linear(dict(zip(model.parameters, row, strict=True))), len(model.states)
    m = np.zeros((x + 1, x + 1))
    m[:x, :x] = dynamics(linear, model.states, 1)[0]
    m[:x, x] = constant_forcing(linear, model.states, 1, {"t_d0": 1.0})[0]
    step, states = scipy.linalg.expm(m * STEP), [np.zeros(x)]
    for torque in experiment.series["t_d0"][:-1]:
        states.append(step[:x, :x] @ states[-1] + step[:x, x] * torque)
    return np.array(states) @ experiment.weights(model.states).T


def processor_time(work: Callable[[], object], repeats: int = 1) -> float:
    """Shortest of several times [s] of this process, whatever else runs."""
    times = []
    for _ in range(repeats):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return min(times)


def main() -> None:
    print("| states | compile [s] | evaluation [us] | slope [us] | error |")
    print("| ---: | ---: | ---: | ---: | ---: |")
    for count in SIZES:
        model, rng = chain(count), np.random.default_rng(count)
        experiment = record(model)
        usual = np.array([USUAL[name[0]] for name in model.parameters])
        full = usual * rng.uniform(0.5, 2.0, (BATCH, len(usual)))
        response = Response(model, experiment)
        compiled = processor_time(lambda r=response, f=full: r.squares(f))
        taken = processor_time(lambda r=response, f=full: r.squares(f), 200)
        some, q = full[:8], 8
        along = some[:, None] * rng.normal(0, 1, (8, q, len(usual)))
        ones = np.ones((8, 4, 1))
        response.normal(some, along, ones)
        slopes = processor_time(lambda r=response, s=(some, along, ones): r.normal(*s), 10)
        true = reference(model, experiment, full[0])
        error = np.abs(response.signals(full[:1])[0] - true).max() / np.abs(true).max()
        print(
            f"| {len(model.states)} | {compiled:.1f} | {1e6 * taken / BATCH:.1f} "
            f"| {1e6 * slopes / 8 / q:.1f} | {error:.0e} |", flush=True,
        )  # fmt: skip


if __name__ == "__main__":
    main()
