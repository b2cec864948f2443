"""NumPyro's NUTS, in its own coordinates for a box of priors and in some made by hand.

Chains take turns on two processes, a few iterations at a time, until the targets that bayesdrill
itself has to meet are met or the budget is spent.  Time is counted from the first iteration of the
warm-up; compiling, which happens before, is told apart.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import time
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from typing import Any

import numpy as np

from benchmarks import modal, problem, verdict
from benchmarks.verdict import Array, Result

WARM_UP = 500  # half of NumPyro's default: enough here, and cheaper
CHUNK = 20  # iterations between looks at the clock
SHOWN = {
    "physical": "physical, logit of the box",
    "modal": "modal",
    "unfolded": "modal, logit of the box",
}
ESS = 4000.0  # as in the bundled config
# One thread for each process: two chains run side by side, each on its own core.
FLAGS = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"


@dataclasses.dataclass(slots=True)
class Chain:
    """`state`: the sampler's, as arrays; `theta`: blocks of draws after the warm-up."""

    state: Any
    seconds: float = 0.0
    iterations: int = 0
    gradients: int = 0
    divergences: int = 0
    theta: list[Array] = dataclasses.field(default_factory=list)

    @property
    def draws(self) -> int:
        return sum(map(len, self.theta))


def kernel(job: problem.Job, coordinates: str, around: Array) -> tuple[Any, Any, Any]:
    """NUTS; a physical draw to its coordinates; its coordinates back to a physical draw.

    `around (n, 9)`, points around the MAP, give the mass matrix to begin with.
    """
    if coordinates == "physical":
        return _with_model(job, around)
    from benchmarks.peers import chart_jax

    straight, back = modal.of(job), chart_jax.physical_from_modal(job)
    if coordinates == "modal":
        return _with_density(
            chart_jax.modal_density(job),
            lambda theta: straight.from_physical(theta[None])[0],
            lambda z: back(z)[0],
            around,
        )
    fold, unfold = chart_jax.modal_from_unfolded(job), chart_jax.unfolded_from_modal(job)
    return _with_density(
        chart_jax.unfolded_density(job),
        lambda theta: unfold(straight.from_physical(theta[None])[0]),
        lambda u: back(fold(u)[0])[0],
        around,
    )


def _with_model(job: problem.Job, around: Array) -> tuple[Any, Any, Any]:
    """As a user of NumPyro writes it."""
    import jax
    import numpyro
    from numpyro import distributions
    from numpyro.infer import NUTS

    from benchmarks.peers import response_jax

    low, high = (jax.numpy.array(end) for end in job.problem.posterior.space.box[1:3])
    record = response_jax.log_likelihood(job)

    def model() -> None:
        box = distributions.Uniform(low, high).to_event(1)
        numpyro.factor("record", record(numpyro.sample("theta", box)))

    support = distributions.biject_to(distributions.constraints.interval(low, high))
    covariance = np.cov(np.array([support.inv(theta) for theta in around]).T)
    nuts = NUTS(model, dense_mass=True, inverse_mass_matrix=covariance / problem.START_SPREAD**2)
    return nuts, lambda theta: {"theta": support.inv(theta)}, lambda z: support(z["theta"])


def _with_density(density: Any, forward: Any, back: Any, around: Array) -> tuple[Any, Any, Any]:
    """Over whitened coordinates: NumPyro's adaptation of the mass adds 0.001 to the variances,
    far more than those of the directions that the record determines."""
    import jax.numpy as jnp
    from numpyro.infer import NUTS

    points = np.array([forward(theta) for theta in around])
    centre = points.mean(axis=0)
    root = np.linalg.cholesky(np.cov(points.T)) / problem.START_SPREAD
    spread, narrow = jnp.array(root), jnp.array(np.linalg.inv(root))
    nuts = NUTS(potential_fn=lambda x: -density(centre + spread @ x), dense_mass=True)
    return (
        nuts,
        lambda theta: narrow @ (jnp.asarray(forward(theta)) - centre),
        lambda x: back(centre + spread @ x),
    )


class Worker:
    """Compiles once, then advances any chain."""

    def __init__(self, coordinates: str, seed: int, first: Array, around: Array) -> None:
        import jax

        begun = time.perf_counter()
        nuts, forward, back = kernel(problem.load(), coordinates, around)

        def step(state: Any, _: Any) -> Any:
            state = nuts.sample(state, (), {})
            return state, (back(state.z), state.diverging, state.num_steps)

        keys = jax.random.split(jax.random.PRNGKey(seed), len(first))
        self.states = [_begin(nuts, key, forward(x)) for key, x in zip(keys, first, strict=True)]
        advance = jax.jit(lambda state: jax.lax.scan(step, state, None, CHUNK))
        self.advance = advance.lower(self.states[0]).compile()
        jax.block_until_ready(self.advance(self.states[0]))  # the first call is slower than others
        self.setup = time.perf_counter() - begun


def _begin(nuts: Any, key: Any, z: Any) -> Any:
    import jax

    first = jax.tree.map(jax.numpy.asarray, z)
    return nuts.init(key, WARM_UP, init_params=first, model_args=(), model_kwargs={})


_POST: dict[str, Worker] = {}


def _enlist(*arguments: Any) -> None:
    os.environ["XLA_FLAGS"] = FLAGS
    _POST["worker"] = Worker(*arguments)


def _ready(index: int, patience: float) -> tuple[float, Any]:
    time.sleep(patience)  # so that every process gets one of these
    return _POST["worker"].setup, _arrays(_POST["worker"].states[index])


def _advance(state: Any) -> tuple[Any, Array, int, int, float]:
    begun = time.perf_counter()
    state, (theta, diverging, steps) = _POST["worker"].advance(state)
    theta = np.asarray(theta)
    return (
        _arrays(state),
        theta,
        int(np.sum(diverging)),
        int(np.sum(steps)),
        time.perf_counter() - begun,
    )


def _arrays(state: Any) -> Any:
    import jax

    return jax.tree.map(np.asarray, state)


def run(job: problem.Job, coordinates: str, budget: float) -> Result:
    centre = problem.mode(job)
    first = problem.starts(job, centre, problem.CHAINS, seed=5)
    around = problem.starts(job, centre, 500, seed=6)
    os.environ["XLA_FLAGS"] = FLAGS
    with ProcessPoolExecutor(
        problem.PROCESSES,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_enlist,
        initargs=(coordinates, 7, first, around),
    ) as pool:
        ready = [pool.submit(_ready, k, 1.0) for k in range(problem.CHAINS)]
        setups, states = zip(*(future.result() for future in ready), strict=True)
        chains = [Chain(state) for state in states]
        begun = time.perf_counter()
        _take_turns(pool, chains, begun + budget)
        seconds = time.perf_counter() - begun
    return _result(chains, coordinates, seconds, max(setups))


def _take_turns(pool: ProcessPoolExecutor, chains: list[Chain], end: float) -> None:
    """The shortest chain goes next; all are judged whenever they have grown by a quarter."""
    running: dict[Future[Any], Chain] = {}
    next_check, enough = 500, False
    while True:
        idle = [chain for chain in chains if not any(chain is other for other in running.values())]
        if not enough and time.perf_counter() < end:
            idle.sort(key=lambda chain: chain.iterations)
            for chain in idle[: problem.PROCESSES - len(running)]:
                running[pool.submit(_advance, chain.state)] = chain
        if not running:
            return
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            _book(running.pop(future), future.result())
        shortest = min(chain.draws for chain in chains)
        if shortest >= next_check and not enough:
            found = verdict.judge(_draws(chains))
            enough = found.r_hat <= verdict.R_HAT and found.ess >= ESS
            next_check = int(shortest * 1.25)


def _book(chain: Chain, done: tuple[Any, Array, int, int, float]) -> None:
    chain.state, theta, divergences, gradients, seconds = done
    chain.gradients += gradients
    chain.seconds += seconds
    if chain.iterations >= WARM_UP:
        chain.theta.append(theta)
        chain.divergences += divergences
    chain.iterations += len(theta)


def _draws(chains: list[Chain]) -> Array:
    shortest = min(chain.draws for chain in chains)
    return np.stack([np.concatenate(chain.theta)[:shortest] for chain in chains])


def _result(chains: list[Chain], coordinates: str, seconds: float, setup: float) -> Result:
    gradients = sum(chain.gradients for chain in chains)
    usual = {"setup": setup, "seconds": seconds, "work": gradients}
    name = "NumPyro, NUTS"
    shown = SHOWN[coordinates]
    each = f"{1e6 * sum(c.seconds for c in chains) / gradients:.0f} us per gradient"
    if min(chain.draws for chain in chains) < CHUNK:
        iterations = min(chain.iterations for chain in chains)
        note = f"still warming up (iteration {iterations} of {WARM_UP}), {each}"
        return verdict.result(name, shown, verdict.nothing(), note=note, **usual)
    found = verdict.judge(_draws(chains))
    draws = sum(chain.draws for chain in chains)
    diverging = sum(chain.divergences for chain in chains) / draws
    after = f"{draws} draws, {diverging:.1%} diverging, {each}, compiling {setup:.0f} s"
    return verdict.result(name, shown, found, note=after, **usual)
