"""A train described in a config: its names, its records, its mistakes; against equations typed anew.

Mutants killed: names of the paper's rig in a train's config, a gear upside down, the unit of a position
taken for that of an angle, an imposed position without its start, a mistake in `model:` after which
every symbol is unknown, a table of another rig.
"""

from __future__ import annotations

import json
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.integrate
from support import command_line
from support.case_tables import for_each
from support.config_mistakes import MISTAKES

from bayesdrill.basics import units
from bayesdrill.config import job, loading
from bayesdrill.config.job import Job, prepare
from bayesdrill.config.records import simulation
from bayesdrill.config.resolve.sensors import build_channel
from bayesdrill.config.schema.config import Config, config_kind
from bayesdrill.config.schema.json_schema import json_schema
from bayesdrill.config.schema.records import ChannelSpec
from bayesdrill.config.schema.vocabulary import HOUSE, vocabulary_of
from bayesdrill.config.yaml_source import parse
from bayesdrill.inference import derived
from bayesdrill.results import provenance
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import with_all
from bayesdrill.rig.models.train import Train

ROTARY = """\
name: arm
seed: 3
record:
  file: arm.csv
  time: {column: t, unit: s}
  channels:
    w_load: {column: w, unit: rpm, sigma: 2.0}
    twist: {column: twist, unit: deg, sigma: 0.2, measures: theta_arm - theta_load}
    theta_motor: {column: motor, unit: revolution, sigma: 0.05}
inputs:
  i_motor: {column: i, unit: mA}
initial: {w_load: {value: 30, unit: rpm}}
model:
  name: train
  inertias: [motor, arm, load]
  gears: {box: {between: [motor, arm], ratio: 0.125}}
  shafts: {coupling: [arm, load]}
  drives: {motor: current}
nominal: {k_coupling: {value: 250, unit: mN*m/rad}}
parameters:
  j_motor: {prior: log_normal, median: 4.0e-4, sd_log: 0.5}
  j_arm: 1.0e-3
  j_load: {prior: log_normal, median: 2.0e-2, sd_log: 0.5}
  k_coupling: {prior: uniform, low: 0.5, high: 1.5, relative: true}
  k_T_motor: 0.12
  c_load: {prior: log_normal, median: 2.0e-3, sd_log: 0.5}
"""

LINEAR = """\
name: carts
seed: 4
record:
  file: carts.csv
  time: {column: t, unit: ms}
  channels:
    x_second: {column: x, unit: mm, sigma: 0.5}
    v_first: {column: v, unit: mm/s, sigma: 3.0}
inputs:
  f_first: {column: f, unit: mN}
initial: {state: given, x_second: {value: 2, unit: mm}}
model:
  name: train
  motion: linear
  inertias: [first, second]
  shafts: {spring: [first, second], wall: [second, ground]}
  drives: {first: torque}
parameters:
  m_first: {prior: log_normal, median: 0.8, sd_log: 0.3}
  m_second: 1.2
  k_spring: {prior: log_normal, median: 400.0, sd_log: 0.3}
  k_wall: {prior: log_normal, median: 300.0, sd_log: 0.3}
  c_first: {prior: log_normal, median: 0.5, sd_log: 0.3}
"""

T = np.arange(120) * 0.01
CURRENT = np.where(np.arange(120) // 30 % 2, -0.4, 0.8)  # A
F = np.where(np.arange(120) // 40 % 2, 1.5, -0.7)  # N
RPM, DEG = np.pi / 30, np.pi / 180


def arm(t: float, x: np.ndarray, p: dict[str, float], i: float) -> list[float]:
    """Of x = (theta_arm, w_arm, theta_load, w_load); the motor turns 8 times as fast as the arm."""
    twist = p["k_coupling"] * (x[0] - x[2])
    inertia = 8**2 * p["j_motor"] + 1e-3
    return [
        x[1],
        (8 * 0.12 * i - twist) / inertia,
        x[3],
        (twist - p["c_load"] * x[3]) / p["j_load"],
    ]


def carts(t: float, x: np.ndarray, p: dict[str, float], f: float) -> list[float]:
    """Of x = (x_first, v_first, x_second, v_second)."""
    spring = p["k_spring"] * (x[0] - x[2])
    first = (f - spring - p["c_first"] * x[1]) / p["m_first"]
    return [x[1], first, x[3], (spring - p["k_wall"] * x[2]) / 1.2]


def integrated(
    rates: Callable[..., list[float]], p: dict[str, float], u: np.ndarray, x: list[float]
) -> np.ndarray:
    """States `(T, 4)` under inputs that are held from sample to sample."""
    states = [np.array(x)]
    for held in u[:-1]:
        step = scipy.integrate.solve_ivp(
            rates, (0, 0.01), states[-1], args=(p, held), rtol=1e-11, atol=1e-13
        )
        states.append(step.y[:, -1])
    return np.array(states)


def log_density(y: np.ndarray, model: np.ndarray, sigma: float) -> float:
    return float(np.sum(-0.5 * ((y - model) / sigma) ** 2 - np.log(sigma * np.sqrt(2 * np.pi))))


def write(folder: Path, text: str, *changes: tuple[str, str]) -> Path:
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "config.yaml"
    path.write_text(text)
    return path


def save(folder: Path, name: str, **columns: np.ndarray) -> None:
    table = np.column_stack([*columns.values()])
    np.savetxt(folder / name, table, delimiter=",", header=",".join(columns), comments="")


def measured(folder: Path) -> dict[str, np.ndarray]:
    """Records that no rig has made: the density must be right wherever the model is wrong."""
    rng = np.random.default_rng(5)
    noise = {name: rng.normal(size=len(T)) for name in ("w", "twist", "motor", "x", "v")}
    y = {
        "w": 30 + 20 * np.sin(3 * T) + noise["w"],
        "twist": 10 * np.cos(9 * T) + noise["twist"],
        "motor": T**2 + 0.05 * noise["motor"],
        "x": 4 * np.sin(12 * T) + noise["x"],
        "v": 40 * np.cos(12 * T) + noise["v"],
    }
    save(folder, "arm.csv", t=T, w=y["w"], twist=y["twist"], motor=y["motor"], i=1e3 * CURRENT)
    save(folder, "carts.csv", t=1e3 * T, x=y["x"], v=y["v"], f=1e3 * F)
    return y


def likelihood(built: Job) -> tuple[dict[str, float], float]:
    """A point beside the start, and its log likelihood."""
    posterior = built.problem.posterior
    theta = posterior.space.vector(posterior.space.start)[None] * 1.07
    (observation,) = posterior.likelihood.observations
    by_channel = observation.by_channel(posterior.space.full(theta), theta)
    named = posterior.space.named(theta)
    return {name: float(np.ravel(x)[0]) for name, x in named.items()}, float(np.sum(by_channel))


def test_the_density_of_a_train_is_that_of_its_equations(tmp_path: Path) -> None:
    y = measured(tmp_path)
    p, found = likelihood(prepare(write(tmp_path, ROTARY)))
    x = integrated(arm, p, CURRENT, [0.0, 0.0, 0.0, 30 * RPM])
    expected = log_density(y["w"] * RPM, x[:, 3], 2 * RPM)
    expected += log_density(y["twist"] * DEG, x[:, 0] - x[:, 2], 0.2 * DEG)
    expected += log_density(y["motor"] * 2 * np.pi, 8 * x[:, 0], 0.05 * 2 * np.pi)
    assert found == pytest.approx(expected, rel=1e-8)


def test_the_density_of_masses_along_a_line_is_that_of_their_equations(tmp_path: Path) -> None:
    y = measured(tmp_path)
    built = prepare(write(tmp_path, LINEAR))
    p, found = likelihood(built)
    x = integrated(carts, p, F, [0.0, 0.0, 2e-3, 0.0])
    expected = log_density(y["x"] * 1e-3, x[:, 2], 5e-4) + log_density(y["v"] * 1e-3, x[:, 1], 3e-3)
    assert found == pytest.approx(expected, rel=1e-8)
    channels = built.problem.observations[0].experiment.channels
    assert [(c.unit, c.shown.name) for c in channels] == [("m", "mm"), ("m/s", "mm/s")]
    speeds = {one.name: one.unit for one in derived.derived_symbols(built.problem)}
    assert speeds["w_end"] == "m/s"


def test_a_steady_start_of_masses_holds_the_first_force(tmp_path: Path) -> None:
    measured(tmp_path)
    given = prepare(write(tmp_path, LINEAR, (", x_second: {value: 2, unit: mm}", "")))
    steady = prepare(
        write(tmp_path, LINEAR, ("{state: given, x_second: {value: 2, unit: mm}}", "steady"))
    )
    p, found = likelihood(steady)
    held = F[0] / p["k_wall"]
    x = integrated(carts, p, F, [held + F[0] / p["k_spring"], 0.0, held, 0.0])
    y = measured(tmp_path)
    expected = log_density(y["x"] * 1e-3, x[:, 2], 5e-4) + log_density(y["v"] * 1e-3, x[:, 1], 3e-3)
    assert found == pytest.approx(expected, rel=1e-8)
    assert found != likelihood(given)[1]


def test_an_imposed_angle_or_position_moves_what_hangs_on_it(tmp_path: Path) -> None:
    """Its speed is held between samples; all begins where it does."""
    measured(tmp_path)
    angle = 0.3 + np.sin(4 * T)

    def check(text: str, letter: str, unit: str, size: float) -> None:
        save(tmp_path, "moved.csv", t=T, a=angle / size, y=np.cos(T) / size)
        inertia, stiffness = {"theta": ("j", 0.5), "x": ("m", 30.0)}[letter]
        path = write(
            tmp_path,
            "name: moved\nseed: 1\nrecord:\n  file: moved.csv\n  time: {column: t, unit: s}\n"
            f"  channels: {{{letter}_load: {{column: y, unit: {unit}, sigma: 1.0}}}}\n"
            f"inputs: {{{letter}_top: {{column: a, unit: {unit}}}}}\n"
            f"initial: {{{letter}_load: 0.3}}\n"
            f"model: {{name: train, {text}inertias: [top, load], shafts: {{rope: [top, load]}}, "
            "drives: {top: speed}}\n"
            f"parameters: {{k_rope: {stiffness}, {inertia}_load: {{prior: log_normal, median: 0.02, "
            "sd_log: 0.1}}\n",
        )
        p, found = likelihood(prepare(path))

        def rates(t: float, x: np.ndarray, p: dict[str, float], w: float) -> list[float]:
            return [w, 0.0, x[3], stiffness * (x[0] - x[2]) / p[f"{inertia}_load"]]

        speeds = np.append(np.diff(angle) / 0.01, 0.0)
        x = integrated(rates, p, speeds, [angle[0], 0.0, 0.3, 0.0])
        assert found == pytest.approx(log_density(np.cos(T), x[:, 2], size), rel=1e-8)

    cases = {"rotary": ("", "theta", "deg", DEG), "linear": ("motion: linear, ", "x", "mm", 1e-3)}
    for_each(cases, check)


def test_a_simulated_record_reads_back_and_a_resolved_config_is_the_same(tmp_path: Path) -> None:
    measured(tmp_path)

    def check(text: str, name: str, channels: int) -> None:
        case = loading.load(write(tmp_path, text))
        record = simulation.simulate(case, seed=1)
        assert record == simulation.simulate(case, seed=1)
        (tmp_path / name).write_text(record)
        built = prepare(write(tmp_path, text))
        start = built.problem.posterior.space.vector(built.problem.posterior.space.start)[None]
        squares = built.problem.posterior.likelihood.mean_square(start)[0]
        assert squares == pytest.approx(1.0, abs=5 * np.sqrt(2 / (channels * len(T))))
        path = tmp_path / "resolved.yaml"
        path.write_text(provenance.resolved(built.case, tmp_path))
        again = prepare(path)
        marks = [provenance.fingerprint(one.config, one.problem) for one in (built, again)]
        assert marks[0] == marks[1]
        assert again.problem.posterior.density(start) == built.problem.posterior.density(start)

    for_each({"rotary": (ROTARY, "arm.csv", 3), "linear": (LINEAR, "carts.csv", 2)}, check)


def test_arrays_and_a_model_are_such_a_config(tmp_path: Path) -> None:
    measured(tmp_path)
    built = prepare(write(tmp_path, ROTARY))
    columns = np.genfromtxt(tmp_path / "arm.csv", delimiter=",", names=True)
    entries = {**built.source.data, "model": job.model_entry(built.case.model)}
    entries["record"] = {"channels": entries["record"]["channels"]}
    again = job.job_in_memory({name: columns[name] for name in columns.dtype.names}, entries)
    assert again.case.model == built.case.model
    assert likelihood(again) == likelihood(built)
    copy = pickle.loads(pickle.dumps(built.config))
    assert copy == built.config
    assert copy.model_fields_set == built.config.model_fields_set


def test_a_mistake_is_told_with_its_value_place_and_a_way_out(tmp_path: Path) -> None:
    measured(tmp_path)

    def check(case: dict[str, Any]) -> None:
        place, path = case["place"], write(tmp_path, ROTARY, *map(tuple, case["replace"]))
        ran = command_line.cli("simulate", path, "--output", tmp_path / "simulated.csv", "--force")
        assert ran.status == 2, ran
        (line,) = [line for line in ran.err.splitlines() if f": {place}: " in line]
        assert line.startswith(f"{path}:")
        assert [text for text in case["says"] if text not in line] == [], line
        others = [line for line in ran.err.splitlines() if ": model." not in line]
        assert not (place.startswith("model.") and others), others

    for_each({name: (case,) for name, case in MISTAKES["train"].items()}, check)


def test_a_current_is_a_state_only_with_an_inductance() -> None:
    rig = Train(inertias=["motor"], drives={"motor": "voltage"})
    spec = ChannelSpec(column="i", unit="A", sigma=0.1)
    with pytest.raises(ValueError, match=r"i_motor is a state only with l_motor; name it"):
        build_channel("i_motor", spec, rig)
    assert build_channel("i_motor", spec, with_all(rig)).weights == {"i_motor": 1.0}


def test_along_a_line_a_mistake_has_its_units(tmp_path: Path) -> None:
    measured(tmp_path)
    changes = {
        "an angle": ("unit: mm,", "unit: deg,", "record.channels.x_second.unit", "m or mm"),
        "a speed": ("unit: mm/s,", "unit: rpm,", "record.channels.v_first.unit", "m/s or mm/s"),
        "a torque": ("unit: mN}", "unit: N*m}", "inputs.f_first.unit", "N or mN"),
        "a letter": ("  m_second", "  j_second", "parameters.j_second", "m_second?"),
    }

    def check(old: str, new: str, place: str, says: str) -> None:
        ran = command_line.cli(
            "simulate", write(tmp_path, LINEAR, (old, new)), "--output", tmp_path / "s"
        )
        assert ran.status == 2, ran
        assert any(f": {place}: " in line and says in line for line in ran.err.splitlines()), (
            ran.err
        )

    for_each(changes, check)


def test_a_torque_may_be_missing_at_any_inertia(tmp_path: Path) -> None:
    measured(tmp_path)
    for text, names, unit in ((ROTARY, "motor arm load", "N*m"), (LINEAR, "first second", "N")):
        for name in names.split():
            size = "{prior: log_uniform, low: 0.01, high: 1.0}"
            torque = f"missing_torque: {{at: {name}, size: {size}, time: 1.0}}\n"
            built = prepare(write(tmp_path, text + torque))
            symbols = {one.name: one.unit for one in built.problem.symbols}
            assert symbols["s_d"] == unit
            assert np.isfinite(likelihood(built)[1])


def test_each_rig_has_its_names_and_those_of_one_vocabulary_share_a_config() -> None:
    for kind in MODELS.usable().values():
        rig = kind()
        assert (vocabulary_of(rig) is HOUSE) != rig.has_private_names
    assert config_kind(HOUSE) is Config
    first, second = (loading.load_kind(parse(Path("x.yaml"), text)) for text in (ROTARY, LINEAR))
    assert first is loading.load_kind(parse(Path("y.yaml"), ROTARY))
    assert {*first.vocabulary.inputs} == {"i_motor"}
    assert {*second.vocabulary.inputs} == {"f_first"}
    assert "theta_motor" in first.vocabulary.signals
    assert "theta_motor" not in first.vocabulary.starts


def test_the_schema_knows_names_of_parts_beside_a_train_alone() -> None:
    schema = json.loads(json_schema())
    names = schema["else"]["properties"]
    assert schema["if"]["properties"]["model"]["properties"]["name"] == {"enum": ["train"]}
    for section in ("parameters", "nominal", "inputs", "initial", "simulation"):
        kind = schema["$defs"][section.capitalize()]
        assert names[section]["propertyNames"]["enum"] == [*kind["properties"]]
        ((pattern, _),) = kind["patternProperties"].items()
        assert kind["additionalProperties"] is False
        for name in ("j_load", "t_c_load", "theta_arm_2", "k_T_motor"):
            assert re.search(pattern, name), name
    assert names["missing_torque"]["properties"]["at"]["enum"] == ["motor", "rotor_1"]


def test_units_along_a_line_are_known_as_those_of_angles_are() -> None:
    """By `units` itself, and as pint has them."""
    import pint

    registry = pint.UnitRegistry()
    for unit, si in (("mm", "m"), ("mm/s", "m/s"), ("mN", "N"), ("N/m", "N/m"), ("kg", "kg")):
        assert units.factor(unit, si) == pytest.approx(
            registry.Quantity(1.0, unit).to(si).magnitude
        )
    for unit, si in (("mm", "rad"), ("rad", "m"), ("rpm", "m/s"), ("N", "N*m"), ("N*m", "N")):
        with pytest.raises(ValueError, match="is not a unit of"):
            units.factor(unit, si)


def test_a_chain_of_gears_turns_steadily(tmp_path: Path) -> None:
    """Its angles do not turn alike: a load behind a second gear goes half as far."""
    rng = np.random.default_rng(8)
    save(tmp_path, "chain.csv", t=T, w=rng.normal(size=len(T)), y=rng.normal(size=len(T)))
    text = """\
name: chain
seed: 1
record:
  file: chain.csv
  time: {column: t, unit: s}
  channels:
    w_load: {column: w, unit: rad/s, sigma: 1.0}
    theta_motor: {column: y, unit: rad, sigma: 1.0}
inputs: {t_motor: 0.6}
initial: {state: steady, theta_load: 0.2}
model:
  name: train
  inertias: [motor, arm, pinion, load]
  gears: {first: {between: [motor, arm], ratio: 0.25}, second: {between: [pinion, load], ratio: -0.5}}
  shafts: {coupling: [arm, pinion]}
  drives: {motor: torque}
parameters:
  j_motor: 0.001
  j_arm: 0.01
  j_pinion: 0.01
  j_load: {prior: log_normal, median: 0.02, sd_log: 0.1}
  k_coupling: 3.0
  c_load: 0.4
"""
    built = prepare(write(tmp_path, text))
    _, found = likelihood(built)
    torque = 0.6 / 0.25  # at the arm, and at the pinion
    end = torque / -0.5 / 0.4  # of the load, where the damper takes what the second gear gives
    twist = torque / 3.0
    motor = 4 * (0.2 / -0.5 + twist + end / -0.5 * T)
    y = np.genfromtxt(tmp_path / "chain.csv", delimiter=",", names=True)
    expected = log_density(y["w"], np.full(len(T), end), 1.0) + log_density(y["y"], motor, 1.0)
    posterior = built.problem.posterior
    theta = posterior.space.vector(posterior.space.start)[None]
    assert derived.values_at(built.problem, theta)["w_end"] == pytest.approx(end / -0.5)
    assert found == pytest.approx(expected, rel=1e-8)
