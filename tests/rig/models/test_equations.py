"""Equations of random trains, with motors and imposed speeds, against the matrices of an `Oracle`."""

from contextlib import suppress

import numpy as np
from support.train_oracle import Oracle, springs

from bayesdrill.basics.errors import InputError
from bayesdrill.rig.models.linear import with_named
from bayesdrill.rig.models.train import Train

RATIOS = (-0.5, 0.25, 2.0, -3.0)


def random_train(rng: np.random.Generator) -> Train:
    """One with parts at random; raises `InputError` where they do not go together."""
    names = tuple(f"d{k}" for k in range(rng.integers(2, 6)))
    pair = lambda ends: tuple(map(str, rng.choice(ends, 2, replace=False)))  # noqa: E731
    kinds = ("torque", "current", "voltage", "speed")
    train = Train(
        inertias=names,
        shafts={f"s{k}": pair((*names, "ground")) for k in range(rng.integers(0, 5))},
        gears={
            f"b{k}": {"between": pair(names), "ratio": float(rng.choice(RATIOS))}
            for k in range(rng.integers(0, 3))
        },
        drives={name: str(rng.choice(kinds)) for name in names if rng.random() < 0.5},
        gravity=tuple(name for name in names if rng.random() < 0.2),
    )
    linear = [name for name in train.offers if name.startswith(("c_", "k_e_", "l_", "t_f_"))]
    return with_named(train, [name for name in linear if rng.random() < 0.6])


def turns(train: Train) -> np.ndarray:
    """`R (n, q)`, found by following gears from the coordinates."""
    place = {name: k for k, name in enumerate(train.inertias)}
    roots = [name.removeprefix("theta_") for name in train.states if name.startswith("theta_")]
    found = np.zeros((len(place), len(roots)))
    found[[place[name] for name in roots], range(len(roots))] = 1.0
    for _ in train.gears:
        for gear in train.gears:
            first, second = (place[end] for end in gear.ends)
            for near, far, ratio in ((first, second, gear.ratio), (second, first, 1 / gear.ratio)):
                if found[near].any() and not found[far].any():
                    found[far] = ratio * found[near]
    return found


def rates(train: Train, p: dict[str, float], x: dict[str, float]) -> dict[str, float]:
    """Rates of the states at `x`, states and inputs by name."""
    place = {name: k for k, name in enumerate(train.inertias)}
    of = lambda letter: np.array([p.get(f"{letter}_{name}", 0.0) for name in place])  # noqa: E731
    angles = [name for name in train.states if name.startswith("theta_")]
    speeds = [name.replace("theta", "w") for name in angles]
    w, r = np.array([x[name] for name in speeds]), turns(train)
    torques, none = -of("t_f"), np.zeros(len(place))
    pendulums = [(k, None, g, 0.0) for k, g in enumerate(of("g"))]  # nearly springs
    own, found = r @ w, dict(zip(angles, w, strict=True))
    for drive in train.drives:
        name, at = drive.inertia, place[drive.inertia]
        voltage = x.get(f"u_{name}", 0.0) - p.get(f"k_e_{name}", 0.0) * own[at]
        current = x.get(f"i_{name}", voltage / p.get(f"r_{name}", np.inf))
        torques[at] += x.get(f"t_{name}", 0.0) + p.get(f"k_T_{name}", 0.0) * current
        if f"l_{name}" in p:
            found[f"i_{name}"] = (voltage - p[f"r_{name}"] * current) / p[f"l_{name}"]
    free = Oracle(
        of("j"), r, springs(train, p) + pendulums, of("c"), none, none, none, lambda _: torques
    )
    pushes = free.force(0.0, np.array([x[name] for name in angles]), w)
    moved = zip(speeds, pushes / np.diag(free.mass + 1e-300), strict=True)
    return found | {name: rate for name, rate in moved if name in train.states}


def test_any_train_moves_by_its_matrices() -> None:
    """Mutants killed: the last friction alone, a motor without current where its speed is imposed."""
    rng, seen = np.random.default_rng(8), 0
    for _ in range(600):
        with suppress(InputError):
            train = random_train(rng)
            p = dict(
                zip(train.parameters, rng.uniform(0.5, 2.0, len(train.parameters)), strict=True)
            )
            x = {name: float(rng.normal()) for name in (*train.states, *train.inputs)}
            linear = train.linear(p)
            found = {**dict.fromkeys(train.states, 0.0), **linear.c}
            for (row, column), value in (*linear.A.items(), *linear.B.items()):
                found[row] += value * x.get(column, 0.0)  # what is beyond a spring is no input
            expected = rates(train, p, x)
            assert {*found} == {*expected}, train
            for name, rate in expected.items():
                assert abs(found[name] - rate) < 1e-9 * max(map(abs, expected.values())), train
            seen += 1
    assert seen > 400
