"""Bounds, misfits and records of known truth."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, ORDER, by_expm, skewed
from support.small_problems import noisy_step, posterior, replace_only, vector

from bayesdrill.config import loading
from bayesdrill.rig import Response
from studies.paper import precision, printed
from studies.paper.forward import regular
from studies.paper.precision import truth_of
from studies.paper.tests.records import UNEVEN, at, target

CONFIGS = Path(__file__).parents[3] / "configs" / "paper"


SIGMA = np.full(4, 0.02)


def test_misfit_is_the_papers() -> None:
    target = posterior(noisy_step(SIGMA, n=40), np.array([0.02, 0.03, 0.05, 0.04]))
    experiment = target.likelihood.only_observation.response.experiment
    states = by_expm(skewed(), experiment.t, np.zeros(5), 8.0, 0.0)[:, :4]
    per = (((experiment.y - states) / [0.02, 0.03, 0.05, 0.04]) ** 2).mean()
    assert precision.misfit_per_number(target, vector(skewed())) == pytest.approx(per, rel=1e-8)
    task = precision.misfit_task(target)
    theta = np.array([vector(NOMINAL), 1.1 * vector(NOMINAL), 3 * vector(NOMINAL)])
    inside = task.density(theta)
    assert inside[:2] == pytest.approx(target.likelihood(theta[:2]))
    assert inside[2] == -np.inf


def test_records_have_the_misfit_that_is_expected_in_nineteen_of_twenty() -> None:
    """400 records; the share has a standard deviation of 1.1 %."""
    rig = target(("k_s",), UNEVEN, 40, at(("k_s",), 1.0))
    truth = vector(NOMINAL)[[ORDER.index("k_s")]]
    found = np.array(
        [
            precision.misfit_per_number(precision.made_record(rig, truth, 5, k), truth)
            for k in range(400)
        ]
    )
    low, high = precision.expected_misfit(rig.likelihood.n_measured)
    assert 0.92 < np.mean((low < found) & (found < high)) < 0.98
    squares = np.random.default_rng(3).standard_normal((8000, 25)) ** 2
    low, high = precision.expected_misfit(25)
    for tail in (squares.mean(axis=1) < low, squares.mean(axis=1) > high):
        assert np.mean(tail) == pytest.approx(0.025, abs=0.007)  # four standard deviations


def test_bounds_of_lengths_are_those_at_a_thousandth_and_repeats_attain_what_is_wanted() -> None:
    rig = target(("c_m", "k_e"), UNEVEN, 51, {})
    one = rig.likelihood.only_observation
    grid = ((0.7, 50.0), (2.0, 120.0))
    attained = printed.TWO_PARAMETERS[1.0]["c_m"].deviation / 100
    for line, size in zip(precision.lengths(rig.likelihood, NOMINAL, grid), grid, strict=True):
        assert (line["duration"], line["rate"]) == size
        longer = regular(one.experiment, *size)
        response = Response(one.response.model, longer)
        noise = one.noise.for_length(len(longer.t))
        own = replace_only(rig.likelihood, response=response, noise=noise)
        relative = precision.at_sigma_1(own, NOMINAL)
        for name, bound in relative.items():
            assert line[f"{name}_percent"] / 100 == pytest.approx(0.001 * bound)
        assert relative["c_m"] / np.sqrt(line["repeats"]) == pytest.approx(attained)


def test_bounds_of_a_long_record_are_of_its_whole_course() -> None:
    """Ten times as many samples of one course tell as much as ten records of it."""
    rig = target(("c_m", "k_e"), UNEVEN, 51, {})
    few, many = precision.lengths(rig.likelihood, NOMINAL, ((40.0, 100.0), (40.0, 1000.0)))
    for bound in ("c_m_percent", "k_e_percent"):
        assert few[bound] / many[bound] == pytest.approx(np.sqrt(10.0), rel=2e-3)


def test_the_implied_noise_is_that_at_which_the_bound_is_the_deviation() -> None:
    """Back from its rows; and deviations that are the bounds at a noise lead to that."""
    one = {"c_m": 37.1, "k_e": 0.29}
    found = {line["row"]: line for line in precision.implied_noise(one)}
    for line in found.values():
        for name in one:
            percent, noise = line[f"{name}_percent"], line[f"noise_{name}"]
            assert noise * one[name] == pytest.approx(percent / 100)
        assert line["ratio"] * line["k_e_percent"] == pytest.approx(line["c_m_percent"])
    assert found["bound"]["noise_c_m"] == pytest.approx(0.001)
    assert found["bound"]["noise_k_e"] == pytest.approx(0.001)
    rows = [found.pop(f"{sigma:g}") for sigma in printed.TWO_PARAMETERS]
    for name in one:
        each = np.array([line[f"{name}_percent"] for line in rows])
        rms = found["rms"][f"{name}_percent"]
        assert rms**2 * len(each) == pytest.approx(each @ each)
        assert each.min() < rms < each.max()
    # A rig whose bounds are the printed deviations of one row, at a noise of 3.
    row = printed.TWO_PARAMETERS[0.1]
    same = precision.implied_noise({name: row[name].deviation / 100 / 3.0 for name in one})[2]
    assert (same["noise_c_m"], same["noise_k_e"]) == pytest.approx((3.0, 3.0))


def test_truth_is_known_only_of_a_record_that_comes_out_again(tmp_path: Path) -> None:
    folder = tmp_path / "paper"
    shutil.copytree(CONFIGS, folder)
    makers = [loading.load(folder / name) for name in ("estimates.yaml", "missing_physics.yaml")]

    def truth(name: str) -> dict[str, float] | None:
        return truth_of(loading.load(folder / name), makers)

    assert truth("estimates.yaml") == pytest.approx(
        {name: cell.value for name, cell in printed.NINE_PARAMETERS.items()}
    )
    seen = truth("measured.yaml")
    assert seen == pytest.approx(printed.with_missing(j_2=printed.J_2, r_s=printed.R_S))
    assert seen["j_m"] == pytest.approx(5.09375e-4)  # 7e-3/64 more
    assert seen["r_m"] == pytest.approx(0.53)
    mend(folder / "measured.yaml", "nominal:", f"model: {TWO_ROTORS}\n\nnominal:")
    own = truth("measured.yaml")  # of the model with nothing missing: what made it
    assert [own["j_m"], own["r_m"]] == [printed.GUESS["j_m"], printed.GUESS["r_m"]]
    mend(folder / "measured.yaml", "r_s: 0.2", "r_s: 0.3")
    assert truth("measured.yaml") is None
    mend(folder / "measured.yaml", f"model: {TWO_ROTORS.replace('0.2', '0.3')}\n\n", "")
    record = folder / "records" / "missing_physics.csv"
    lines = record.read_text().splitlines()
    lines[500] = ",".join(f"{1.001 * float(x):.9g}" for x in lines[500].split(","))
    record.write_text("\n".join(lines[:500] + lines[501:]) + "\n")
    assert truth("measured.yaml") is None
    assert truth("two_parameters.yaml") is None


TWO_ROTORS = "{name: two_rotors, j_2: 7.0e-3, r_s: 0.2}"


def mend(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))


@run_cases(
    "head, row",
    [("t,phi [\xb0],theta_2,w_1,w_2", "0,0,0,0,0"), (None, '"0","0","0","0","0"')],
    ids=["Latin-1", "quoted"],
)
def test_a_record_that_no_simulation_writes_has_no_truth(
    head: str | None, row: str, tmp_path: Path
) -> None:
    folder = tmp_path / "paper"
    shutil.copytree(CONFIGS, folder)
    record = folder / "records" / "missing_physics.csv"
    heads, first, *rest = record.read_text().splitlines()
    record.write_bytes("\n".join([head or heads, row or first, *rest]).encode("latin-1"))
    makers = [loading.load(folder / "missing_physics.yaml")]
    assert truth_of(loading.load(folder / "measured.yaml"), makers) is None
