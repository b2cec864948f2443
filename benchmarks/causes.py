"""Records with one lack each, and whether `map` names it first: `python -m benchmarks.causes`.

Each record is simulated by a rig that has something which its config lacks, or is changed by a mistake
of columns, sensors or clocks.  Of each kind nine of ten have to be named first, and what absorbs any
misfit is never first where a cause with a name is right.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bayesdrill as bd

Array = NDArray[np.float64]
Config = dict[str, Any]

RIGHT = 0.9  # of the records of a kind
RHO = 0.8  # of noise that remembers
DT = 0.01


@dataclass
class Bench:
    """A rig under test: a `config` that fits its `columns`, which `clean` has without noise."""

    config: Config
    clean: dict[str, Array]
    sigma: Mapping[str, float]
    inputs: dict[str, Array]
    t: Array
    memory: float = 0.0
    files: dict[str, dict[str, Array]] = field(default_factory=dict)

    def write(self, folder: Path, rng: np.random.Generator) -> Path:
        """Write record and config; return the path of the config."""
        columns: dict[str, Array] = {}
        for name, clean in self.clean.items():
            noise = rng.standard_normal(len(clean))
            for k in range(1, len(noise) if self.memory else 0):
                noise[k] = self.memory * noise[k - 1] + math.sqrt(1 - self.memory**2) * noise[k]
            columns[name] = clean + self.sigma[name] * noise
        record = {"t": self.t, **columns, **self.inputs}
        for stem, table in {"record": record, **self.files}.items():
            rows, head = np.column_stack([*table.values()]), ",".join(table)
            np.savetxt(folder / f"{stem}.csv", rows, "%.10g", ",", header=head, comments="")
        path = folder / "config.yaml"
        path.write_text(json.dumps(self.config))
        return path

    @property
    def channels(self) -> Config:
        return dict(self.config["record"]["channels"])


def log_uniform(value: float, factor: float = 10.0) -> Config:
    return {"prior": "log_uniform", "low": value / factor, "high": value * factor}


def config(name: str, channels: Config, **rest: Any) -> Config:
    """A config whose channels are columns of their names in one record."""
    channels = {channel: {"column": channel, **entry} for channel, entry in channels.items()}
    time = {"column": "t", "unit": "s"}
    record = {"file": "record.csv", "time": time, "channels": channels}
    return {"name": name, "seed": 1, "record": record, **rest}


def about(value: float, rng: np.random.Generator) -> float:
    return float(value * np.exp(0.1 * rng.standard_normal()))


def both_ways(t: Array, rng: np.random.Generator, size: float = 6.0) -> Array:
    """A voltage that turns a rig both ways, with something faster on it."""
    square = np.sign(np.sin(rng.uniform(2, 4) * t + rng.uniform(0, 6)))
    volts = size * square + 0.25 * size * np.sin(rng.uniform(8, 14) * t) + rng.uniform(-0.5, 0.5)
    return np.asarray(np.round(volts, 4))


def motor_shaft(
    rng: np.random.Generator, lacks: Mapping[str, float], i_m: float = 0.125, n: int = 500
) -> Bench:
    """A motor, a gear, a shaft and a rotor, of which both speeds are measured."""
    truth = {"j_m": 1e-4, "r_m": 1.0, "k_s": 0.6, "j_1": 0.02, "c_s": 8e-3}
    truth = {name: about(value, rng) for name, value in truth.items()}
    held = {"c_m": 1e-4, "k_e": 0.06, "k_T": 0.06, "l_m": 1.5e-3, "t_f": 0.0}
    t = DT * np.arange(n)
    v = both_ways(t, rng)
    added = tuple(x for x in bd.MotorShaft().offers if x in {*lacks, "c_s"})
    rig = bd.MotorShaft(i_m=i_m, added=added)
    moved = bd.respond(rig, {**truth, **held, **lacks}, t, {"v": v}, ["w_1", "w_2"])
    sigma = {name: 0.02 * float(np.std(y)) for name, y in moved.items()}
    said = config(
        "shaft",
        {name: {"unit": "rad/s", "sigma": s} for name, s in sigma.items()},
        inputs={"v": {"column": "v", "unit": "V"}},
        model={"name": "motor_shaft", "i_m": 0.125},
        parameters={**held, **{name: log_uniform(x) for name, x in truth.items()}},
    )
    return Bench(said, dict(moved), sigma, {"v": v}, t)


def tabled(rng: np.random.Generator, lacks: Mapping[str, float], i_m: float = 0.125) -> Bench:
    """The same rig with a nominal table, its twist and the angle at the gear."""
    truth = {n: x * np.exp(0.08 * rng.standard_normal()) for n, x in bd.nominal().items()}
    truth |= {name: bd.nominal()[name] for name in ("r_m", "l_m", "t_f")}
    t = DT * np.arange(500)
    v = both_ways(t, rng)
    rig = bd.MotorShaft(i_m=i_m, added=tuple(x for x in bd.MotorShaft().offers if x in lacks))
    measures = {"theta_2": "theta_2", "twist": "theta_1 - theta_2", "w_1": "w_1"}
    moved = bd.respond(rig, {**truth, **lacks}, t, {"v": v}, [*measures.values()])
    clean = {name: moved[what] for name, what in measures.items()}
    sigma = {"theta_2": 0.02, "twist": 0.02, "w_1": 0.1}
    units = {"theta_2": "rad", "twist": "rad", "w_1": "rad/s"}
    channels = {
        name: {"unit": units[name], "sigma": sigma[name], "measures": what}
        for name, what in measures.items()
    }
    box = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
    held = dict.fromkeys(("r_m", "l_m", "t_f"), "nominal")
    said = config(
        "tabled",
        channels,
        inputs={"v": {"column": "v", "unit": "V"}},
        model={"name": "motor_shaft", "i_m": 0.125},
        nominal="tables_2_3",
        parameters={**dict.fromkeys(truth, box), **held},
    )
    return Bench(said, clean, sigma, {"v": v}, t)


def train(
    rng: np.random.Generator, lacks: Mapping[str, float], parts: Config | None = None
) -> Bench:
    """A motor under a voltage that turns a load through a gear and a coupling, as a train."""
    model: Config = {
        "inertias": ["motor", "arm", "load"],
        "gears": {"box": {"between": ["motor", "arm"], "ratio": 0.1}},
        "shafts": {"coupling": ["arm", "load"]},
        "drives": {"motor": "voltage"},
    }
    truth = {"j_motor": 2e-5, "j_load": 0.01, "k_coupling": 3.0, "c_coupling": 0.02}
    truth = {name: about(value, rng) for name, value in truth.items()}
    held = {"j_arm": 1e-5, "k_T_motor": 0.05, "r_motor": 1.2, "k_e_motor": 0.05}
    t = DT * np.arange(500)
    u = both_ways(t, rng, 8.0)
    more = parts or {}
    whole = {key: {**model[key], **more.get(key, {})} for key in ("gears", "shafts", "drives")}
    names = (*model["inertias"], *more.get("inertias", ()))
    plain = bd.Train(inertias=names, **whole)
    values = {**truth, **held, **lacks}
    rig = bd.Train(inertias=names, **whole, added=tuple(x for x in plain.offers if x in values))
    moved = bd.respond(rig, values, t, {"u_motor": u}, ["w_arm", "w_load"])
    sigma = {name: 0.02 * float(np.std(y)) for name, y in moved.items()}
    said = config(
        "train",
        {name: {"unit": "rad/s", "sigma": log_uniform(s, 30.0)} for name, s in sigma.items()},
        inputs={"u_motor": {"column": "u_motor", "unit": "V"}},
        model={"name": "train", **model},
        parameters={**held, **{name: log_uniform(x) for name, x in truth.items()}},
    )
    return Bench(said, dict(moved), sigma, {"u_motor": u}, t)


def decay(
    rng: np.random.Generator, lacks: Mapping[str, float], *, second: bool = False, held: float = 0.0
) -> Bench:
    """A cart on a spring, let go; `second`: another on it; `held` for so long at first [s]."""
    truth = {"m_cart": 1.0, "c_cart": 0.8}
    truth = {name: about(value, rng) for name, value in truth.items()}
    spring: Config = {"spring": ["cart", "ground"]}
    whole: Config = {"motion": "linear", "inertias": ("cart",), "shafts": spring}
    if second:
        whole |= {"inertias": ("cart", "other"), "shafts": {**spring, "link": ["cart", "other"]}}
    offers = bd.Train(**whole).offers
    rig = bd.Train(**whole, added=tuple(name for name in offers if name in {*lacks, "c_cart"}))
    t = 0.008 * np.arange(600)
    start = {"x_cart": 0.04, **({"x_other": 0.04} if second else {})}
    values = {**truth, "k_spring": 300.0, **lacks}
    free = bd.respond(rig, values, t, {}, ["x_cart", "v_cart"], initial=start)
    clean = {name: delayed(y, int(held / 0.008)) for name, y in free.items()}
    sigma, units = {"x_cart": 2e-4, "v_cart": 5e-3}, {"x_cart": "m", "v_cart": "m/s"}
    said = config(
        "decay",
        {name: {"unit": units[name], "sigma": log_uniform(s, 100.0)} for name, s in sigma.items()},
        inputs={},
        initial="free",
        model={"name": "train", "motion": "linear", "inertias": ["cart"], "shafts": spring},
        parameters={"k_spring": 300.0, **{name: log_uniform(x) for name, x in truth.items()}},
    )
    return Bench(said, clean, sigma, {}, t)


def arm(rng: np.random.Generator, weight: float, *, geared: bool) -> Bench:
    """An arm of this weight that a torque swings, or a motor by a voltage through a gear."""
    inertias, drive = (("motor", "arm"), "motor") if geared else (("arm",), "arm")
    model: Config = {"inertias": [*inertias], "drives": {drive: "voltage" if geared else "torque"}}
    model |= {"gears": {"box": {"between": ["motor", "arm"], "ratio": 0.05}}} if geared else {}
    motor = {"j_motor": 1e-5, "k_T_motor": 0.03, "k_e_motor": 0.03, "r_motor": 2.0}
    truth = {name: about(value, rng) for name, value in {"j_arm": 0.02, "c_arm": 0.01}.items()}
    known, t = motor if geared else {}, DT * np.arange(500)
    names = {**truth, **known}
    rig = bd.Train(**{**model, "inertias": inertias}, gravity=("arm",))
    rig = replace(rig, added=tuple(name for name in rig.offers if name in names))
    name, unit = ("u_motor", "V") if geared else ("t_arm", "N*m")
    push = both_ways(t, rng, 4.0 if geared else 0.7)
    moved = bd.respond(rig, {**names, "g_arm": weight}, t, {name: push}, ["theta_arm"])
    sigma = {"theta_arm": 0.01}
    said = config(
        "arm",
        {"theta_arm": {"unit": "rad", "sigma": sigma["theta_arm"]}},
        inputs={name: {"column": name, "unit": unit}},
        model={"name": "train", **model},
        parameters={**known, **{name: log_uniform(x) for name, x in truth.items()}},
    )
    return Bench(said, dict(moved), sigma, {name: push}, t)


def delayed(y: Array, samples: int) -> Array:
    return np.concatenate([np.full(samples, y[0]), y[: len(y) - samples]])


def one_channel(bench: Bench, name: str) -> Bench:
    """The same with this channel alone."""
    bench.config["record"]["channels"] = {name: bench.channels[name]}
    bench.clean = {name: bench.clean[name]}
    return bench


# Kinds: each makes a record of a seed, and says which part is right.

Kind = Callable[[np.random.Generator, int], tuple[Bench, str]]


def gain(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    bench = tabled(rng, {}) if seed % 2 else train(rng, {})
    name = "twist" if seed % 2 else "w_load"
    bench.clean[name] = bench.clean[name] * rng.choice([0.8, 1.25])
    return bench, f"gain_{name}"


def offset(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    bench = motor_shaft(rng, {}) if seed % 2 else decay(rng, {})
    name = "w_1" if seed % 2 else "x_cart"
    bench.clean[name] = bench.clean[name] + 6.0 * bench.sigma[name] * rng.choice([-1.0, 1.0])
    return bench, f"offset_{name}"


def lag(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    bench = motor_shaft(rng, {}) if seed % 2 else train(rng, {})
    name = "w_1" if seed % 2 else "w_load"
    bench.clean[name] = delayed(bench.clean[name], int(rng.integers(2, 6)))
    return bench, f"lag_{name}"


def friction(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    if seed % 3 == 0:
        return motor_shaft(rng, {"t_c1": rng.uniform(0.05, 0.12)}), "friction_rotor_1"
    if seed % 3 == 1:
        return train(rng, {"t_c_load": rng.uniform(0.05, 0.15)}), "friction_load"
    return decay(rng, {"f_c_cart": rng.uniform(0.1, 0.4)}), "friction_cart"


def gear(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    return tabled(rng, {}, float(rng.choice([1 / 16, 1 / 14, 1 / 5, 1 / 4, 1 / 20]))), "gear"


def damping(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    if seed % 2:
        return tabled(rng, {"c_s": rng.uniform(4e-3, 8e-3)}), "damping_shaft"
    return train(rng, {"c_load": rng.uniform(0.01, 0.03)}), "damping_load"


def memory(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    bench = (tabled, train, decay)[seed % 3](rng, {})
    bench.memory = RHO
    return bench, "ar1"


def sign(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    bench = (motor_shaft, tabled, train, decay)[seed % 4](rng, {})
    # Of a swing either is the sign.
    name = rng.choice([*bench.clean][: 1 if seed % 4 == 3 else None])
    bench.clean[name] = -bench.clean[name]
    return bench, f"sign_{name}"


def exchange(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    bench = (motor_shaft, train, tabled)[seed % 3](rng, {})
    first, second = ("theta_2", "twist") if seed % 3 == 2 else (*bench.clean,)
    bench.clean[first], bench.clean[second] = bench.clean[second], bench.clean[first]
    return bench, f"exchange_{first}_{second}"


def clock(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    bench = motor_shaft(rng, {}) if seed % 2 else train(rng, {})
    ((name, u),) = bench.inputs.items()
    bench.files["input"] = {"t": bench.t, name: u}
    bench.inputs = {}
    own = {"file": "input.csv", "time": {"column": "t", "unit": "s"}}
    bench.config["inputs"][name] |= own
    bench.t = np.round(bench.t * float(rng.choice([0.975, 0.985, 1.01, 1.02, 1.03])), 6)
    bench.t = bench.t[bench.t <= bench.files["input"]["t"][-1]]
    bench.clean = {channel: y[: len(bench.t)] for channel, y in bench.clean.items()}
    return bench, "clock"


def drop(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    size = rng.uniform(0.6, 1.5)
    return (tabled if seed % 2 else motor_shaft)(rng, {"v_d": size}), "voltage_drop"


def load_friction(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    eta = rng.uniform(0.6, 0.8)
    if seed % 2:
        return train(rng, {"eta_box": eta}), "load_friction_motor"
    return motor_shaft(rng, {"eta": eta}), "load_friction_motor"


def inertia(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    if seed % 4 == 0:
        beyond = {"j_0": about(0.01, rng), "k_0": about(3.0, rng), "c_0": about(0.01, rng)}
        return motor_shaft(rng, beyond), "inertia_rotor_1"
    if seed % 4 == 1:
        parts = {"inertias": ["tip"], "shafts": {"flex": ["load", "tip"]}}
        beyond = {"j_tip": about(0.004, rng), "k_flex": about(2.0, rng), "c_flex": 0.01}
        return train(rng, beyond, parts), "inertia_load"
    beyond = {"m_other": about(0.5, rng), "k_link": about(200.0, rng)}
    bench = decay(rng, beyond, second=True)
    return (bench if seed % 4 == 2 else one_channel(bench, "x_cart")), "inertia_cart"


def drag(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    if seed % 4 == 0:
        return motor_shaft(rng, {"d_1": about(0.008, rng)}), "drag_rotor_1"
    if seed % 4 == 1:
        return train(rng, {"d_load": about(0.008, rng)}), "drag_load"
    bench = decay(rng, {"d_cart": about(6.0, rng)})
    return (bench if seed % 4 == 2 else one_channel(bench, "x_cart")), "drag_cart"


def gravity(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    return arm(rng, rng.uniform(0.3, 1.2), geared=bool(seed % 2)), "gravity_arm"


def held_at_first(rng: np.random.Generator, seed: int) -> tuple[Bench, str]:
    bench = decay(rng, {}, held=rng.uniform(0.05, 0.4))
    return (bench if seed % 2 else one_channel(bench, "x_cart")), "later"


KINDS: dict[str, Kind] = {
    each.__name__: each
    for each in (
        gain, offset, lag, friction, gear, damping, memory, sign, exchange, clock, drop, load_friction,
        inertia, drag, gravity, held_at_first,
    )
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Found:
    """What `map` named first, and what was right; `absorbed`: the first absorbs any misfit."""

    kind: str
    seed: int
    right: str
    first: tuple[str, ...]
    absorbed: bool
    seconds: float


def find(kind: str, seed: int) -> Found:
    """Map one record."""
    rng = np.random.default_rng([seed, sum(map(ord, kind))])
    bench, right = KINDS[kind](rng, seed)
    with tempfile.TemporaryDirectory() as folder:
        case = bd.load(bench.write(Path(folder), rng))
        begun = time.process_time()
        ranked = case.find_map().candidates().ranked
    seconds, first = time.process_time() - begun, ranked[0] if ranked else None
    parts, absorbed = (first.parts, bool(first.absorbing)) if first else ((), False)
    return Found(kind, seed, right, parts, absorbed, seconds)


def arguments(given: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.causes", description=__doc__)
    parser.add_argument("--only", nargs="+", metavar="KIND", choices=[*KINDS], default=[*KINDS])
    parser.add_argument("--records", type=int, default=10, help="of each kind")
    parser.add_argument("--processes", type=int, default=2)
    return parser.parse_args(given)


def tell(kind: str, found: Sequence[Found]) -> bool:
    """Print the line of a kind, and return whether it misses a bar."""
    wrong = [one for one in found if one.first != (one.right,)]
    absorbed = sum(one.absorbed for one in found) if kind != "memory" else 0
    others = "; ".join(f"{one.seed}: {'-'.join(one.first) or 'nothing'}" for one in wrong)
    seconds = float(np.median([one.seconds for one in found]))
    right = f"{len(found) - len(wrong)} of {len(found)}"
    print(f"{kind:15} {right:>8} {absorbed:8} {seconds:8.1f}  {others}", flush=True)
    return len(wrong) > (1 - RIGHT) * len(found) + 1e-9 or absorbed > 0


def main(given: Sequence[str] | None = None) -> int:
    options = arguments(given)
    wanted = [(kind, seed) for kind in options.only for seed in range(options.records)]
    failed = 0
    print(f"{'kind':15} {'right':>8} {'absorbed':>8} {'median s':>8}  first where another is right")
    with ProcessPoolExecutor(options.processes, mp_context=get_context("spawn")) as pool:
        every = {pair: pool.submit(find, *pair) for pair in wanted}
        for kind in options.only:
            failed += tell(kind, [each.result() for pair, each in every.items() if pair[0] == kind])
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
