"""A record in a few numbers: its sums of squares against 80-bit simulation, bounds, fallbacks."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.linear_oracle import ExactMotion
from support.scipy_oracles import ORDER, skewed
from support.small_problems import experiment, vector

from bayesdrill.rig.compression.basis import BLOCK, CompressionError, basis_of, choose_basis
from bayesdrill.rig.compression.simulator import CompressedSimulator, compress, even_record
from bayesdrill.rig.models.motor_shaft import DrivenShaft, MotorShaft
from bayesdrill.rig.models.train import Train
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.sensors import ObservationModel, ObservedWalkers

SIGMA = 0.1
DT = 0.01
FOUR = {name: {name: 1.0} for name in MotorShaft.states[:4]}


def steps(n: int, seed: int = 1) -> np.ndarray:
    """A voltage that steps at random between 4 and 12 V."""
    rng = np.random.default_rng(seed)
    return np.where(rng.random(n // 20 + 1) < 0.5, 4.0, 12.0).repeat(20)[:n]


def near(n: int, spread: float = 1e-3, seed: int = 2) -> np.ndarray:
    """Rigs near the skewed one `(n, P)`, itself first."""
    rng = np.random.default_rng(seed)
    factors = np.exp(spread * rng.standard_normal((n, len(ORDER))))
    factors[0] = 1.0
    return vector(skewed()) * factors


def recorded(p: np.ndarray, dt: float, v: np.ndarray, rng: np.random.Generator) -> Response:
    """A record of a rig `(P,)` under a voltage, with noise."""
    record = experiment(len(v), dt, constant={}, series={"v": v}, measures=FOUR)
    y = Response(MotorShaft(), record).signals(p[None])[0]
    y = y + SIGMA * rng.standard_normal(y.shape)
    return Response(MotorShaft(), dataclasses.replace(record, y=y))


def measured(n: int = 1001) -> Response:
    """A record of steps of voltage with noise."""
    return recorded(vector(skewed()), DT, steps(n), np.random.default_rng(3))


def made(response, points: np.ndarray) -> CompressedSimulator:
    channels = response.experiment.y.shape[1]
    variances = np.full(channels, SIGMA**2)
    compression = compress(response, points, variances, 1.0 / variances[:, None])
    return compression.applied(response)


def true_squares(response: Response, full: np.ndarray) -> np.ndarray:
    true = ExactMotion(response.model, response.experiment, full).signals()
    return np.nansum((response.experiment.y - true) ** 2, axis=0)


@pytest.fixture(scope="module")
def one() -> CompressedSimulator:
    return made(measured(), near(64))


def test_log_likelihoods_are_those_of_80_bit_simulation(one: CompressedSimulator) -> None:
    points = near(9, seed=5)
    squares, bounds = (numbers[..., 0] for numbers in one.expanded(points))
    truth = np.array([true_squares(one.uncompressed, point) for point in points])
    wrong = np.abs(squares - truth).astype(float) / (2 * SIGMA**2)
    assert wrong.sum(axis=1).max() < 1e-9
    assert (np.abs(squares - truth) <= bounds + 1e-11 * truth).all()
    exact = np.abs(one.uncompressed.squares(points) - truth).max()
    assert np.abs(one.squares(points) - truth).max() < exact


def test_sums_are_exact_where_the_current_follows_at_once() -> None:
    """Of a rig whose fastest pole is beyond any number of terms that is not chosen by its size."""
    points = near(64)
    points[:, ORDER.index("l_m")] = 1e-10
    response = recorded(points[0], DT, steps(501), np.random.default_rng(3))
    squares = made(response, points).squares(points[:4])
    truth = np.array([true_squares(response, point) for point in points[:4]], dtype=float)
    assert np.abs(squares / truth - 1.0).max() < 1e-10


def drive(seed: int, n: int, rng: np.random.Generator) -> np.ndarray:
    """A voltage of one of four kinds: steps, a sweep, noise, a ramp."""
    t = np.arange(n)
    kinds = (
        steps(n, seed),
        8.0 + 4.0 * np.sin(2e-4 * t**2),
        6.0 + 3.0 * rng.standard_normal(n),
        12.0 * np.minimum(1.0, t / 300.0),
    )
    return kinds[seed // 4 % 4]


def draws(response: Response, theta: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Rigs about `theta (P,)` `(256, P)`, one to eight sds or some per cent away; itself first."""
    k, p = response.experiment.y.shape[1], len(theta)
    weights = np.full((1, k, 1), SIGMA**-2)
    information = response.normal(theta[None], np.diag(theta)[None], weights)[2][0]
    values, vectors = np.linalg.eigh(information)
    sds = np.minimum(np.maximum(values, 1e-30) ** -0.5, 0.02)
    sizes = np.append(0.0, np.resize([8.0, 3.0, 1.0], 255))
    shifts = (rng.standard_normal((256, p)) * sds) @ vectors.T
    return theta * np.exp(sizes[:, None] * shifts)


def other_rig(seed: int) -> tuple[np.random.Generator, float, np.ndarray]:
    """A generator, the step of a record, and a rig `(P,)` that is another by a factor of two or so."""
    rng, dt = np.random.default_rng(seed), (0.002, 0.005, 0.01, 0.02)[seed % 4]
    return rng, dt, vector(skewed()) * np.exp(0.7 * rng.standard_normal(len(ORDER)))


def test_rigs_that_hardly_damp_beside_a_slow_pole_have_a_bound() -> None:
    """Of a pair whose real part is nearly that of a real pole: only its turn keeps them apart."""
    for seed in (2, 6, 14, 23):
        rng, dt, p = other_rig(seed)
        points = p * np.exp(1e-3 * rng.standard_normal((40, len(ORDER))))
        one = made(recorded(points[0], dt, steps(1001, seed), rng), points)
        assert not one.exceeds_limit(*one.expanded(points)).any(), seed


@pytest.mark.parametrize(
    "seeds", [range(20, 36, 5), pytest.param(range(20, 40), marks=pytest.mark.slow)], ids=len
)
def test_errors_of_sums_are_within_their_bounds_for_other_rigs_and_inputs(seeds: range) -> None:
    """Against 80-bit simulation at draws of the posterior."""
    wrong = {}
    for seed in seeds:
        rng, dt, p = other_rig(seed)
        response = recorded(p, dt, drive(seed, 1001, rng), rng)
        points = draws(response, p, rng)
        one = made(response, points)
        near_ones = points[3::3][:6]
        squares, bounds = (numbers[..., 0] for numbers in one.expanded(near_ones))
        assert not one.exceeds_limit(*one.expanded(near_ones)).any(), seed
        for point, sums, bound in zip(near_ones, squares, bounds, strict=True):
            left = true_squares(response, point)
            error = np.abs(sums - left).astype(float)
            assert (error <= bound + 1e-11 * left).all(), seed
            wrong[seed] = max(wrong.get(seed, 0.0), float(error.sum()) / (2.0 * SIGMA**2))
    assert max(wrong.values()) < 1e-9


def of_neighbours(response: Simulator, points: np.ndarray) -> CompressedSimulator:
    """Compressed with sums of steps and ends, as noise that remembers wants them."""
    k = response.experiment.y.shape[1]
    weights = np.tile([0.3, 0.9, 0.4], (k, 1)) / SIGMA**2
    compression = compress(response, points, np.full(k, SIGMA**2), weights)
    return compression.applied(response)


def imposed(
    changes: np.ndarray, n: int = 1501, *, critical: bool = False, steady: bool = False
) -> tuple[Response, np.ndarray]:
    """A shaft that is turned at its end, and rigs whose damping at the rotor has these changes.

    It moves at the start, and gains and offsets of its sensors change, too.  Kernels of its few states
    compile in a fifth of the time.
    """
    rng = np.random.default_rng(13)
    w_2 = 5.0 + 0.05 * np.cumsum(rng.standard_normal(n))
    values = {"k_s": 0.26, "j_1": 0.0283, "c_1": 4e-3}
    if critical:
        values["c_1"] = 2.0 * np.sqrt(values["k_s"] * values["j_1"])
    model = DrivenShaft(added=("c_1",))
    names = {"theta_1": {"theta_1": 1.0}, "w_1": {"w_1": 1.0}}
    record = experiment(
        n, DT, constant={"t_1": 0.0}, series={"w_2": w_2}, first_order=True, measures=names,
        start={} if steady else {"theta_1": 3.0, "theta_2": 1.0, "w_1": 5.0},
    )  # fmt: skip
    sensing = ObservationModel(
        gains={"w_1": "gain"}, offsets={"theta_1": "offset"}, input_offsets={"w_2": "bias"},
        steady=steady,
    )  # fmt: skip
    row = [*(values[name] for name in model.parameters), 1.1, 0.2, 0.3]
    points = np.repeat([row], len(changes), axis=0)
    points[:, model.parameters.index("c_1")] *= 1.0 + changes
    points[:, -3:] += 0.01 * np.random.default_rng(11).standard_normal((len(changes), 3))
    truth = Response(model, record, sensing).signals(points[:1])[0]
    y = truth + SIGMA * rng.standard_normal(truth.shape)
    order = np.argsort(np.abs(changes), kind="stable")  # the reference in the middle
    return Response(model, dataclasses.replace(record, y=y), sensing), points[order]


def little(seed: int) -> np.ndarray:
    """Changes of damping by some per cent."""
    return 0.01 * np.random.default_rng(seed).standard_normal(40)


@pytest.mark.parametrize("thinned", [False, True])
def test_steps_and_ends_are_those_of_the_exact_simulator(thinned: bool) -> None:
    """Of channels that are sampled alike, and of one that is sampled less often and begins late.

    Mutants killed: steps across blocks that are lost, ends that are those of a block.
    """
    response, points = imposed(little(20), BLOCK + 1201)
    if thinned:
        y = response.experiment.y.copy()
        late = np.arange(len(y)) % 3 != 1
        late[:200] = True
        y[late, 1] = np.nan
        record = dataclasses.replace(response.experiment, y=y)
        response = simulator(response.model, record, response.sensing)
    rng = np.random.default_rng(21)
    mine = of_neighbours(response, points)
    exact = response.neighbours(points)
    # Steps are what is left of products that nearly cancel.
    assert np.allclose(mine.neighbours(points), exact, rtol=1e-8, atol=1e-9 * exact.max())
    assert np.allclose(mine.squares(points), response.squares(points), rtol=1e-8, atol=0)
    assert not mine.exceeds_limit(*mine.expanded(points)).any()
    along = points[:9, None, :] * rng.standard_normal((9, 4, points.shape[1]))
    rho = rng.uniform(-0.9, 0.99, (9, 2))
    over = 1.0 / (1.0 + rho)
    remembers = np.stack([(1.0 - rho) * over, rho * over / (1.0 - rho), rho * over], axis=-1)
    for weights in (remembers, np.full((9, 2, 1), 2.0)):
        parts = (points[:9], along, weights)
        for computed, true in zip(mine.normal(*parts), response.normal(*parts), strict=True):
            assert np.abs(computed - true).max() < 1e-7 * np.abs(true).max()


def with_gaps() -> tuple[Response, np.ndarray]:
    """A record in which one channel misses many samples, and both some."""
    response, points = imposed(little(10))
    y = response.experiment.y.copy()
    y[:, 0][np.random.default_rng(9).random(len(y)) < 0.4] = np.nan
    y[100:300] = np.nan
    return response.with_record(y), points


def critical() -> tuple[Response, np.ndarray]:
    """Rigs to both sides of critical damping, c_1 = 2 sqrt(k_s j_1); the reference is on the edge."""
    response, points = imposed(np.linspace(-0.02, 0.02, 41), critical=True)
    poles = np.linalg.eigvals(ObservedWalkers(response.sensors, points).system[0])
    assert 0.3 < np.mean((poles.imag != 0).any(axis=1)) < 0.7
    return response, points


@pytest.mark.parametrize(
    "make",
    [with_gaps, lambda: imposed(little(12), steady=True), critical],
    ids=["moving start, gaps", "steady start", "critical"],
)
def test_sums_are_those_of_the_exact_simulator(
    make: Callable[[], tuple[Response, np.ndarray]],
) -> None:
    response, points = make()
    mine = made(response, points)
    assert not mine.exceeds_limit(*mine.expanded(points)).any()
    assert np.allclose(mine.squares(points), response.squares(points), rtol=1e-9, atol=0)
    rng, (n, p) = np.random.default_rng(15), points.shape
    along = rng.standard_normal((n, 3, p)) * points[:, None, :]
    weights = np.full((n, response.experiment.y.shape[1], 1), SIGMA**-2)
    normal = (simulated.normal(points, along, weights) for simulated in (mine, response))
    for computed, true in zip(*normal, strict=True):
        assert np.abs(computed - true).max() < 1e-7 * np.abs(true).max()


@settings(max_examples=60, deadline=None)
@given(
    spread=st.floats(-4.0, -0.5), seed=st.integers(0, 2**31), column=st.integers(0, len(ORDER) - 1)
)
def test_errors_of_sums_are_within_their_bounds(
    one: CompressedSimulator, spread: float, seed: int, column: int
) -> None:
    points = near(8, 10.0**spread, seed)
    points[1:, column] *= 1.5
    squares, bounds = (numbers[..., 0] for numbers in one.expanded(points))
    exact = one.uncompressed.squares(points)
    known = np.isfinite(bounds)
    # Neither knows more digits than this.
    rounding = 1e-9 * (exact + np.abs(exact).max(axis=1, keepdims=True)) + 1e-6 * SIGMA**2
    assert (np.abs(squares - exact) <= bounds + rounding)[known].all()


def test_rigs_far_away_have_the_exact_simulator(one: CompressedSimulator) -> None:
    points = near(6, 0.5, seed=15)
    points[0] *= 1.0 + 1e-5
    beyond = one.exceeds_limit(*one.expanded(points))
    assert beyond[1:].all()
    assert not beyond[0]
    assert np.array_equal(one.squares(points)[1:], one.uncompressed.squares(points)[1:])
    along = np.repeat(np.eye(len(ORDER))[None], 6, axis=0)
    scales = np.ones((6, len(FOUR)))
    for mine, exact in zip(
        one.normal(points, along, scales[..., None] ** 2),
        one.uncompressed.normal(points, along, scales[..., None] ** 2),
        strict=True,
    ):
        assert np.array_equal(mine[1:], exact[1:])


def test_sums_without_a_bound_need_no_samples_of_rigs_far_away(one: CompressedSimulator) -> None:
    """However far, on the ridge of a symmetry too, where poles are the very same and states are not.

    Mutant killed: rigs far away ask for all samples where any sums will do.
    """

    class Forbidden:
        def __getattr__(self, name: str) -> object:
            raise AssertionError(f"{name} of all samples")

    points = near(8, seed=7)
    electric = [ORDER.index(name) for name in ("k_T", "r_m", "l_m")]
    ridge = np.repeat(points[:1], 40, axis=0)
    ridge[:, electric] *= np.geomspace(0.05, 20.0, 40)[:, None]
    assert one.exceeds_bound(ridge).any()
    alone = dataclasses.replace(one.unbounded, uncompressed=Forbidden())
    weights = np.full((40, one.experiment.y.shape[1], 1), SIGMA**-2)
    along = np.repeat(np.diag(points[0])[None], 40, axis=0)
    alone.normal(ridge, along, weights)
    assert not alone.exceeds_bound(ridge).any()
    some = one.normal(points, along[:8], weights[:8])
    for found, expected in zip(alone.normal(points, along[:8], weights[:8]), some, strict=True):
        assert np.array_equal(found, expected)


def test_what_cannot_be_compressed_says_why() -> None:
    even = measured(301)
    rubbing = simulator(MotorShaft(added=("t_cm",)), even.experiment, ObservationModel())
    with pytest.raises(CompressionError, match="dry friction"):
        compress(rubbing, np.ones((2, 10)), np.ones(4), np.ones((4, 1)))
    late = simulator(MotorShaft(), even.experiment, ObservationModel(lags={"w_1": "lag"}))
    points = np.concatenate([near(2), np.zeros((2, 1))], axis=1)
    with pytest.raises(CompressionError, match="its channels or inputs are delayed"):
        compress(late, points, np.ones(4), np.ones((4, 1)))
    t = even.experiment.t.copy()
    t[1:-1] += 1e-3 * np.random.default_rng(16).random(len(t) - 2)
    uneven = simulator(MotorShaft(), dataclasses.replace(even.experiment, t=t), ObservationModel())
    with pytest.raises(CompressionError, match="evenly"):
        compress(uneven, near(2), np.ones(4), np.ones((4, 1)))
    with pytest.raises(CompressionError, match=r"too uncertain|too large"):
        compress(even, near(64, 0.5), np.full(4, SIGMA**2), np.full((4, 1), SIGMA**-2))


def test_a_mode_that_does_not_decay_has_no_functions() -> None:
    with pytest.raises(CompressionError, match="decay"):
        choose_basis(np.array([[[0.1]]]), DT, 1e-10)


def test_a_walker_does_not_depend_on_its_neighbours(one: CompressedSimulator) -> None:
    points = near(19, seed=17)
    together = one.squares(points)
    alone = np.concatenate([one.squares(point[None]) for point in points])
    assert np.array_equal(together, alone)
    assert np.array_equal(one.signals(points), one.by_samples.signals(points))


def test_functions_do_not_grow_with_the_record() -> None:
    short, long = (made(measured(n), near(64)) for n in (2001, 20001))
    assert long.functions <= short.functions + 8


def turning(*turns: float) -> np.ndarray:
    """Phi - 1 of rigs with one pair each, that hardly decays and turns by so much in a step."""
    values = np.exp(-1e-3 + 1j * np.array(turns)) - 1.0
    pairs = [[[a.real, a.imag], [-a.imag, a.real]] for a in values]
    return np.array(pairs)


def test_pairs_that_turn_nearly_half_round_in_a_step() -> None:
    """Mutant killed: a least turn that leads out of the unit circle."""
    basis = basis_of(turning(3.1, 3.0999, 3.1001), np.zeros((2, 0)), 1e-12)
    assert all(abs(1.0 + pole.mu) < 1.0 for pole in basis.poles)


def test_pairs_whose_turns_are_known_too_little_are_refused() -> None:
    """Mutant killed: a middle of pairs that is none."""
    with pytest.raises(CompressionError, match="too uncertain"):
        basis_of(turning(0.3, 0.1, 0.5), np.zeros((2, 0)), 1e-12)


def test_speeds_of_a_free_train_do_not_depend_on_its_angle() -> None:
    """Nothing holds a train, so its speeds are the same at any angle.

    Mutant killed: entries of plain numbers, whose rounding is a spring to ground.
    """
    train = Train(
        inertias=("a", "b", "c"), drives={"a": "torque"}, added=("c_c",),
        shafts={"first": ["a", "b"], "second": ["b", "c"]},
    )  # fmt: skip
    p = np.array([0.013, 0.0037, 0.021, 3.3, 7.7, 0.03])
    speeds = [name for name in train.states if name.startswith("w_")]
    found = []
    for turned in (0.0, 1e6):
        angles = {name: turned for name in train.states if name not in speeds}
        record = experiment(
            10001, 1e-3, constant={}, series={"t_a": steps(10001)},
            measures={name: {name: 1.0} for name in speeds}, start=angles,
        )  # fmt: skip
        reference = even_record(Response(train, record))
        found.append(np.concatenate([shown for _, shown in reference.responses(p)]))
    assert np.abs(found[1] - found[0]).max() < 1e-9
