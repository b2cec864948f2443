"""Physics that a config switches on by naming its parameter: what is made of it, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from support import command_line
from support.case_tables import for_each
from support.config_mistakes import check_mistakes
from support.first_configs import draft_of, reversing_rig, write_table
from support.scipy_oracles import NOMINAL, matrices

import bayesdrill as bd
from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
from bayesdrill.config.job import prepare
from bayesdrill.config.records import simulation
from bayesdrill.report import words
from bayesdrill.results import provenance
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.motor_shaft import OFFERS, MotorShaft

LAST = "  t_f: nominal\n"
C_S = "c_s: {prior: log_uniform, low: 1.0e-4, high: 0.1}"
T, DT = 161, 0.025


def config(folder: Path, *lines: str, **sections: str) -> Path:
    """The small experiment with these `lines` in `parameters:`, and other or further sections."""
    text = command_line.SMALL.replace(LAST, LAST + "".join(f"  {line}\n" for line in lines))
    for name, entry in sections.items():
        kept = [line for line in text.splitlines() if not line.startswith(f"{name}:")]
        text = "\n".join([*kept, f"{name}: {entry}"]) + "\n"
    path = folder / "small.yaml"
    path.write_text(text)
    return path


def simulated(path: Path) -> Path:
    done = command_line.cli("simulate", path)
    assert done.status == 0, done.err
    return path


def model(path: Path) -> Model:
    return loading.load(path).model


def moved(c_s: float, r_s: float, n: int = T) -> np.ndarray:
    """States (n, 5) of the nominal rig with these, by SciPy's exponential."""
    a, v, _, friction = matrices(NOMINAL)
    a[2, 2:4] += np.array([-c_s, c_s]) / NOMINAL["j_1"]
    a[3, 2:4] += np.array([c_s, -c_s]) / NOMINAL["j_m"] / 64
    a[4, 4] -= r_s / NOMINAL["l_m"]
    whole = np.zeros((6, 6))
    whole[:5, :5], whole[:5, 5] = a, 8.0 * v + friction
    start = np.append(np.zeros(5), 1.0)
    return np.array([(scipy.linalg.expm(whole * DT * k) @ start)[:5] for k in range(n)])


ALL = dict.fromkeys(OFFERS, "0.5")


def test_to_name_a_parameter_is_to_switch_its_physics_on(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """In the order of the rig, not of the file."""
    cases = [
        ((), ()),
        ((C_S,), ("c_s",)),
        (("v_d: 0.0", "c_1: 0.001", "c_s: 0.01"), ("c_s", "c_1", "v_d")),
        (("t_cm: {tie: t_f}", "j_2: 0.2*j_1", "r_s: r_m/2"), ("j_2", "r_s", "t_cm")),
        (("eta: {prior: uniform, low: 0.6, high: 1}",), ("eta",)),
        (tuple(f"{name}: {value}" for name, value in ALL.items()), tuple(OFFERS)),
    ]

    def check(lines: tuple[str, ...], added: tuple[str, ...]) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        path = config(tmp_path, *lines, model="{name: motor_shaft, i_m: 0.2, stribeck: 2}")
        assert model(path) == MotorShaft(0.2, 2, added)
        (one,) = loading.load(path).experiments
        space = one.rig_numbers.space()
        assert space.model == one.model.parameters
        assert {"c_s", "eta"} & {*space.free} == {
            n for n in ("c_s", "eta") if f"{n}: {{pr" in f"{lines}"
        }

    for_each({str(case): case for case in cases}, check)


def test_mistakes_are_said_with_their_way_out(tmp_path_factory: pytest.TempPathFactory) -> None:
    def load(folder: Path, *lines: str, **sections: str) -> object:
        return loading.load(config(folder, *lines, **sections))

    check_mistakes("composed", tmp_path_factory, load)


def test_one_mistake_hides_no_other_and_makes_none(tmp_path: Path) -> None:
    """A spoilt parameter is still one that was named."""
    formula = "eta_0: {prior: uniform, low: 1, high: 2, unit: mm}"
    path = config(
        tmp_path,
        "t_cm: 0.1",
        "w_sm: 2.0",
        "t_sm: many",
        "c_s: -1.0",
        quantities=f"{{{formula}}}",
        derived="{ratio: c_s/c_m, other: c_x}",
    )
    with pytest.raises(InputError) as caught:
        loading.load(path)
    places = [str(one).removeprefix(f"{path}:").split(": ")[1] for one in caught.value.problems]
    assert sorted(places) == ["derived.other", "parameters.c_s", "parameters.t_sm"]


def test_a_name_of_the_house_is_no_quantity(tmp_path: Path) -> None:
    path = config(tmp_path, "c_s: eta*k_s", quantities="{eta: 0.01}")
    with pytest.raises(InputError, match=r"quantities\.eta: eta has a meaning of its own here"):
        loading.load(path)


def test_a_simulated_record_has_what_is_named(tmp_path: Path) -> None:
    """Mutant killed: a rig that is simulated without what the config adds."""
    path = config(tmp_path, C_S, "r_s: r_m/3", simulation="{duration: 4.0, rate: 40, c_s: 0.02}")
    text = path.read_text().replace("sigma: 0.05", "sigma: 1.0e-7")
    path.write_text(text)
    rows = simulation.simulate(loading.load(path), 3).splitlines()
    found = np.array([line.split(",") for line in rows[1:]], dtype=float)
    true = moved(0.02, 0.11)[:, [0, 2]]
    columns = [rows[0].split(",").index(name) for name in ("theta_1", "w_1")]
    assert found[:, columns] == pytest.approx(true, abs=1e-5)
    assert np.abs(true - moved(0.0, 0.11)[:, [0, 2]]).max() > 0.1


def test_a_run_says_what_was_added(tmp_path: Path) -> None:
    """In words, and so that no run is resumed with other physics."""
    added = simulated(config(tmp_path, C_S, "r_s: 0.1"))
    job = prepare(added)
    assert words.model(job.problem).startswith("motor_shaft with c_s, r_s (i_m = 0.125; the motor")
    said = command_line.cli("check", added).out
    assert "unknown: k_e, j_1, c_s\n" in said
    assert "r_s = 0.1" in said
    assert "c_s [N m s/rad]: log-uniform from 0.0001 to 0.1" in said
    told_ = provenance.fingerprint(job.config, job.problem)
    assert told_["the model"] == "MotorShaft(i_m=0.125, added=('c_s', 'r_s'))"
    plain = prepare(config(tmp_path, simulation="{duration: 5, rate: 20}"))
    without = provenance.fingerprint(plain.config, plain.problem)
    assert without["the model"] == "MotorShaft(i_m=0.125)"


def test_each_experiment_may_have_its_own(tmp_path: Path) -> None:
    names = "{slow: {record: {file: a.csv}}, fast: {record: {file: b.csv}, inputs: {v: 12.0}}}"
    path = config(tmp_path, C_S, experiments=names, own="[c_s]")
    case = loading.load(path)
    rig = case.model
    assert rig.parameters[9:] == ("c_s",)
    assert case.space().free == ("k_e", "j_1", "c_s_slow", "c_s_fast")
    assert len(simulation.simulate_all(case, 1, tmp_path)) == 2


def test_lines_of_a_first_config_switch_it_on(tmp_path: Path) -> None:
    t, v, x = reversing_rig()
    columns = {"t": t, "v": v, "w_1": x[:, 2], "w_2": x[:, 3]}
    record = write_table(tmp_path / "both.csv", columns)
    draft = draft_of(record)["text"]
    off = tmp_path / "off.yaml"
    off.write_text(draft)
    assert model(off).parameters == MotorShaft.parameters
    lines = [line for line in draft.splitlines() if "half_normal" in line and "# c_s" in line]
    lines += [line for line in draft.splitlines() if "half_normal" in line and "# t_cm" in line]
    assert len(lines) == 2
    for line in lines:
        draft = draft.replace(line, line.replace("# ", "", 1))
    on = tmp_path / "on.yaml"
    on.write_text(draft)
    assert model(on).parameters[9:] == ("c_s", "t_cm")


def test_arrays_with_damping_find_it_again() -> None:
    x, rng = moved(0.02, NOMINAL["r_m"] / 2), np.random.default_rng(4)
    channels = {
        name: bd.Channel(x[:, k] + 0.01 * rng.standard_normal(T), unit, 0.01)
        for name, k, unit in (("w_1", 2, "rad/s"), ("w_2", 3, "rad/s"))
    }
    box = {"prior": "uniform", "low": 0.5, "high": 2.0, "relative": True}
    given = dict.fromkeys(NOMINAL, "nominal") | {
        "c_s": {"prior": "half_normal", "scale": 0.05},
        "k_s": box,
        "r_s": "r_m/2",
        "j_2": 0.0,
        "c_1": "c_s*1.0e-6",
    }
    t = DT * np.arange(T)
    case = bd.case(t, channels, {"v": 8.0}, given, nominal="tables_2_3")
    assert case.unknowns == ("k_s", "c_s")
    best = case.find_map()
    assert best.values["c_s"] == pytest.approx(0.02, rel=0.02)
    assert best.values["k_s"] == pytest.approx(NOMINAL["k_s"], rel=0.005)
    rig = MotorShaft(added=("c_s", "v_d"))
    with pytest.raises(InputError, match=r"parameters\.v_d: the rig has it; give a prior"):
        bd.case(t, channels, {"v": 8.0}, given, rig=rig)
    with pytest.raises(InputError, match=r"^added: motor_shaft has no 'c_2' to add; did you mean"):
        MotorShaft(added=("c_2",))


def test_a_rig_by_itself_takes_what_is_named() -> None:
    t = DT * np.arange(T)
    found = bd.respond(
        "motor_shaft", NOMINAL | {"c_s": 0.02, "r_s": 0.11}, t, {"v": 8.0}, ["w_1", "i"]
    )
    true = moved(0.02, 0.11)
    assert found["w_1"] == pytest.approx(true[:, 2], abs=1e-8)
    assert found["i"] == pytest.approx(true[:, 4], abs=1e-8)
    for wrong, says in (
        ({"t_sm": 0.1}, "parameters.t_sm: t_sm means nothing without t_cm and w_sm"),
        ({"c_s": -0.1}, "parameters.c_s: -0.1 is negative"),
        ({"eta": 1.1}, "parameters.eta: 1.1 is more than 1"),
        ({"c_2": 0.1}, "parameters.c_2: the rig has none"),
        (
            {"t_cm": 0.2, "t_sm": 0.1, "w_sm": 1.0},
            "parameters.t_sm: is below t_cm; static friction",
        ),
    ):
        with pytest.raises(InputError) as caught:
            bd.respond("motor_shaft", NOMINAL | wrong, t, {"v": 8.0}, ["w_1"])
        assert [str(one)[: len(says)] for one in caught.value.problems] == [says]
    free = bd.respond("motor_shaft", NOMINAL | {"t_f": 0.0, "c_m": 0.0}, t, {"v": 0.0}, ["w_2"])
    assert np.abs(free["w_2"]).max() == 0.0


def test_a_rig_that_rubs_takes_fewer_walkers_unless_it_is_told_how_many(tmp_path: Path) -> None:
    def walkers(line: str, sampler: str) -> int:
        return loading.load(config(tmp_path, line, sampler=sampler)).config.sampler.walkers

    assert walkers(C_S, "{ensembles: 5}") == 256
    assert walkers("t_c1: 0.1", "{ensembles: 5}") == 96
    assert walkers("t_c1: 0.1", "{walkers: 256}") == 256
