"""The studies of the paper against oracles: its own LaTeX, SciPy's least squares, finite elements."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from oracles import NOMINAL, ORDER, by_expm, skewed
from rigs import experiment, measured, posterior, starting, vector
from together import together

from bayesdrill.analysis import plausibility
from bayesdrill.config import loading
from bayesdrill.inference.priors import Uniform
from bayesdrill.paper import forward, precision, printed, searches
from bayesdrill.paper import searches as study
from bayesdrill.paper.forward import SIX_STATES, integrate, six_states
from bayesdrill.paper.plugins import Pairwise
from bayesdrill.paper.precision import truth_of
from bayesdrill.sampling.workers import WorkerPool

ROOT = Path(__file__).parents[2]
PAPER = ROOT.parent / "shared" / "paper" / "ENIEF2013-3496_paper.tex"
CONFIGS = ROOT / "configs" / "paper"
SIGMA = np.full(4, 0.02)
TWO = ("c_m", "k_e")


def rows(label: str) -> list[list[str]]:
    """Cells of the table of the paper that has this label."""
    text = PAPER.read_text()
    end = text.index(rf"\label{{{label}}}")
    body = text[text.rindex(r"\begin{tabular}", 0, end) : end]
    return [line.split("&") for line in body.split(r"\\") if "times" in line]


def numbers(cell: str) -> list[float]:
    power = re.search(r"10\^\{(-?\d+)\}", cell)
    first = re.search(r"[\d.]+", cell)
    return [float(first.group()) * 10.0 ** int(power.group(1) if power else 0)]


@pytest.mark.skipif(not PAPER.exists(), reason="the paper's source is not there")
def test_tables_are_those_of_the_paper() -> None:
    for line in rows("tab_estimation_2param"):
        sigma = float(line[0].split()[-1])
        own = printed.TWO_PARAMETERS[sigma]
        found = [numbers(cell)[0] for cell in line[1:5]]
        assert found == pytest.approx(
            [own["c_m"].value, own["c_m"].deviation, own["k_e"].value, own["k_e"].deviation]
        )
    lines = rows("tab:bancada.est.exp")
    assert len(lines) == len(printed.NINE_PARAMETERS)
    for line in lines:
        name = re.search(r"\$(\w+)\$", line[0]).group(1)
        own = printed.NINE_PARAMETERS[name]
        found = [numbers(cell)[0] for cell in line[1:4]]
        assert found == pytest.approx([printed.GUESS[name], own.value, own.deviation])


def test_inconsistencies_are_what_they_say() -> None:
    every = printed.inconsistencies()
    found = {i["what"].split(":")[0]: i for i in every if "Table 3: dev" in i["what"]}
    # 5.0 over 4.0 is 25 %, not the 28 that is printed; 587.7 over 601.6 is 2.3 %, as printed.
    assert found["j_m in Table 3"]["implied"] == pytest.approx(25.0)
    assert "k_e in Table 3" not in found
    assert printed.implied("l_m") == pytest.approx(1.1e-3 * 0.767)
    assert {i["printed"] for i in every if "Table 2" in i["what"]} == {
        0.60,
        0.82,
        0.0061,
    }


def test_every_reading_is_followed_for_half_a_minute() -> None:
    """Against the exponential of its six states. Mutants killed: the speed then for the last one, or
    that of the record's end; an error of one time alone.
    """
    found = forward.readings(experiment(101), NOMINAL)
    assert [reading.row["name"] for reading in found] == list(forward.READINGS)
    for reading in found:
        model = forward.READINGS[reading.row["name"]][1]
        augmented = np.zeros((7, 7))
        augmented[:6, :6], augmented[:6, 6] = six_states(model, NOMINAL, {"v": 8.0})
        speed = SIX_STATES.index("w_2")
        then, last = (scipy.linalg.expm(t * augmented)[speed, 6] for t in (30.0, 1e4))
        assert (reading.row["time"], reading.t[-1]) == (30.0, 30.0)
        assert reading.row["w_2"] == pytest.approx(then, rel=1e-6, abs=1e-6)
        assert reading.row["w_end"] == pytest.approx(last, rel=1e-4, abs=1e-4)
        assert reading.curve[-1] == reading.row["w_2"]
        stepped = integrate(augmented[:6, :6], augmented[:6, 6], np.zeros(6), reading.t)
        assert reading.row["w_2_trapezoid"] == pytest.approx(stepped.x[-1, speed], rel=1e-9)
        off = np.abs(stepped.x[:, speed] - reading.curve).max()
        assert reading.row["error"] == pytest.approx(off, rel=1e-6)


def test_bounds_are_those_of_numeric_slopes() -> None:
    target = posterior(measured(SIGMA), SIGMA, free=TWO)
    truth = np.array([NOMINAL[name] for name in TWO])
    step = 1e-4 * truth
    slopes = [
        (
            target.likelihood.signals((truth + s)[None])
            - target.likelihood.signals((truth - s)[None])
        )
        / (2 * s.sum())
        for s in np.diag(step)
    ]
    rows_ = np.stack([slope.ravel() for slope in slopes])
    expected = np.sqrt(np.diag(np.linalg.inv(rows_ @ rows_.T)))
    assert precision.bounds(target.likelihood, truth) == pytest.approx(expected, rel=1e-5)


@together("way", precision.WAYS)
@together("sigma", [0.001, 0.3])
def test_estimates_are_those_of_least_squares(way: str, sigma: float) -> None:
    """Negative ones too.  Mutant killed: the prior kept in the density (it ends at zero)."""
    priors = {"c_m": Uniform(0.0, 0.02), "k_e": Uniform(0.0, 0.2)}
    start = {"c_m": 1e-3, "k_e": 1e-2}
    target = starting(posterior(measured(SIGMA), SIGMA, free=TWO, priors=priors), start)
    truth = np.array([NOMINAL[name] for name in TWO])
    indices = (3, 4, 5)
    found = study.estimates(target, way, sigma, truth, 7, indices)
    scale = sigma * precision.bounds(target.likelihood, truth)
    negative = 0
    for row, index in zip(found, indices, strict=True):
        own = precision.made_record(precision.with_sigma(target, sigma), truth, 7, index)
        y = own.likelihood.only_observation.response.experiment.y

        def rest(steps: np.ndarray, y: np.ndarray = y) -> np.ndarray:
            at = (truth + scale * steps)[None]
            return ((target.likelihood.signals(at)[0] - y) / sigma).ravel()

        best = scipy.optimize.least_squares(rest, np.zeros(2), diff_step=1e-3, x_scale=1.0)
        assert row == pytest.approx(truth + scale * best.x, abs=0.05 * scale[0])
        negative += row[0] < 0
    assert negative or sigma < 0.1


def test_distance_from_the_truth_is_split_along_the_symmetries() -> None:
    symmetries = [
        tuple(int(name in ["j_m", "c_m", "k_s", "j_1", "t_f", "k_T"]) for name in ORDER),
        tuple(int(name in ["l_m", "r_m", "k_T"]) for name in ORDER),
    ]
    truth = vector(skewed())
    moved = truth * np.exp(0.7 * np.array(symmetries[0]) - 0.3 * np.array(symmetries[1]))
    scales, rest, distance = searches.distinct_ends(moved, truth, symmetries)
    assert scales == pytest.approx((0.7, -0.3))
    assert rest == pytest.approx(0.0, abs=1e-12)
    moved[ORDER.index("k_e")] *= np.exp(0.6)  # which no symmetry has
    scales, rest, further = searches.distinct_ends(moved, truth, symmetries)
    assert scales == pytest.approx((0.7, -0.3))
    assert rest == pytest.approx(0.6 / 3.0)
    assert further > distance
    assert searches.distinct_ends(moved, truth, [])[1:] == pytest.approx((further, further))


def test_misfit_is_the_papers() -> None:
    target = posterior(measured(SIGMA, n=40), np.array([0.02, 0.03, 0.05, 0.04]))
    experiment = target.likelihood.only_observation.response.experiment
    states = by_expm(skewed(), experiment.t, np.zeros(5), 8.0, 0.0)[:, :4]
    per = (((experiment.y - states) / [0.02, 0.03, 0.05, 0.04]) ** 2).mean()
    assert precision.misfit_per_number(target, vector(skewed())) == pytest.approx(per, rel=1e-8)
    task = precision.misfit_task(target)
    theta = np.array([vector(NOMINAL), 1.1 * vector(NOMINAL), 3 * vector(NOMINAL)])
    inside = task.density(theta)
    assert inside[:2] == pytest.approx(target.likelihood(theta[:2]))
    assert inside[2] == -np.inf


def test_path_of_the_heuristic_begins_and_ends_at_its_misfits() -> None:
    target = posterior(measured(SIGMA, n=60), SIGMA, free=("k_e", "k_s", "j_1"))
    names = target.space.free
    own = Pairwise()
    start = {name: 1.15 * NOMINAL[name] for name in names}
    target = starting(target, start)
    with WorkerPool(target, 1) as pool:
        found = searches.run_heuristic(pool, target, searches.MisfitSearch(own, 5000), 3, 5)
    assert found.misfits[0] == pytest.approx(precision.misfit_per_number(target, found.guess))
    assert found.misfits[-1] == pytest.approx(
        precision.misfit_per_number(target, found.estimate), rel=1e-6
    )
    assert np.all(np.diff(found.misfits) <= 1e-9)
    assert found.misfits[-1] < 0.01 * found.misfits[0]
    assert len(np.unique(found.others[:, 0])) == 3


def test_products_do_not_change_with_the_scales_and_missing_physics_is_exact() -> None:
    target = posterior(measured(SIGMA, n=60), SIGMA)
    guess = vector(dict(printed.GUESS))
    factors = np.ones(9)
    for group, factor in (("j_m c_m k_s j_1 t_f k_T", 1.7), ("l_m r_m k_T", 0.6)):
        factors[[ORDER.index(name) for name in group.split()]] *= factor
    draws = guess * factors * np.exp(1e-9 * np.random.default_rng(1).standard_normal((50, 9)))
    for cause in printed.causes(target, guess, guess * factors, draws):
        assert cause["heuristic"] == pytest.approx(1.0)
        assert cause["posterior"] == pytest.approx(1.0)
        assert cause["alone"] < np.inf
    found = {c["quantity"]: c for c in printed.causes(target, guess, guess, draws)}
    # j_m grows by 7e-3/64 to 5.09375e-4, r_m by 0.2 to 0.53.
    assert found["k_s/j_m"]["both"] == pytest.approx(4 / 5.09375)
    assert found["r_m/l_m"]["r_s"] == pytest.approx(0.53 / 0.33)
    assert found["r_m j_m/(k_T k_e)"]["both"] == pytest.approx(0.53 / 0.33 * 5.09375 / 4)
    assert found["k_s/j_1"]["table_3"] == pytest.approx(2.7 / 2.6 * 28.3 / 29.8)


def test_tones_of_the_shaft_are_those_of_finite_elements() -> None:
    """Many short springs and discs; the second tone converges with their square."""
    j_1, j_2, n = 28.3e-3, 0.0256, 400
    area = np.pi * plausibility.SHAFT_DIAMETER**4 / 32
    length = plausibility.SHAFT_LENGTH / n
    spring, disc = plausibility.STEEL * area / length, printed.DENSITY * area * length
    stiffness, inertia = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))
    for k in range(n):
        stiffness[k : k + 2, k : k + 2] += spring * np.array([[1, -1], [-1, 1]])
        inertia[k : k + 2, k : k + 2] += disc / 6 * np.array([[2, 1], [1, 2]])
    inertia[0, 0] += j_1
    inertia[-1, -1] += j_2
    squares = scipy.linalg.eigh(stiffness, inertia, eigvals_only=True, subset_by_index=[1, 3])
    found = printed.natural_frequencies(j_1, j_2, 3)
    expected = np.sqrt(squares) / (2 * np.pi)
    assert [tone["distributed"] for tone in found] == pytest.approx(expected, rel=1e-4)
    assert found[0]["distributed"] / found[0]["lumped"] == pytest.approx(1.0, abs=1e-6)


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


@together(
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
