"""A Kalman filter sample after sample: for gaps, uneven times, slopes, smoothing and draws.

Once the covariances are steady they are left alone, until a gap or another step.  The smoother goes back
by adjoints (Bryson and Frazier 1963; Bierman 1973), without inverting a covariance:

    r <- Phi' r      r <- r + c' (e / S - k' r)  channel by channel      x + P r  is the smoothed state
"""

from __future__ import annotations

from llvmlite import ir

from bayesdrill.basics.duals import Dual, dual
from bayesdrill.rig.kernels.kalman_update import (
    StateSpace,
    emit_transition,
    gain_width,
    inverse_deviation,
    predict_covariance,
    update_covariance,
    update_state,
)
from bayesdrill.rig.kernels.lanes import (
    I64,
    LANES,
    NUMBERS,
    VEC,
    VECTORS,
    Lane,
    Loop,
    anywhere,
    function,
    intrinsic,
    load,
    splat,
    store,
    vector,
)
from bayesdrill.rig.kernels.numbers import Memory, Number, dot, emit_copy, emit_factor, fused, root

WHOLE = I64.as_pointer()
SAME = 1e-13  # of a variance: what it still changes when it is taken to have settled
SAME_SLOPE = 1e-10

# G groups, T samples, M lengths of steps; the last of them leads to the first sample, if there is
# a lead.
COUNTS = ("groups", "samples", "steps", "lead")
BLOCKS = {
    "parameters": VECTORS,  # (G, P) numbers
    "variances": VECTORS,  # (G, K) numbers, of the noise
    "left": VECTORS,  # (G, T, K) numbers: measured minus model; normals to draw with (G, T, n + K)
    "seen": NUMBERS,  # (T, K) one, or zero
    "node": WHOLE,  # (T,) which step leads to the next sample
    "same": WHOLE,  # (T,) whether gaps and step are as at the sample before
    "spans": NUMBERS,  # (M,)
    "weights": NUMBERS,  # (K, n) of channels
    "table": VECTORS,  # scratch (M, 2, n, n) numbers
    "kept": VECTORS,  # scratch (T, `Steps.kept`) where it smooths
    "out": VECTORS,  # (G, T, K, 2) numbers, whitened and variances; or (G, T, n), (G, T, n + K)
}


def write_filter(module: ir.Module, system: StateSpace, name: str) -> None:
    """`whiten`, `slopes` (whiten with slopes), `smooth` or `draw`, of COUNTS and addresses of BLOCKS."""
    (_emit_draw if name == "draw" else _emit_filter)(module, system, name)


class _Writer:
    """Where a group of walkers has its numbers."""

    def __init__(self, module: ir.Module, system: StateSpace, name: str) -> None:
        made = function(module, name, len(COUNTS), list(BLOCKS.values()))
        names = (*COUNTS, *BLOCKS)
        self.a = dict(zip(names, made.args, strict=True))
        b = self.b = ir.IRBuilder(made.append_basic_block())
        self.system, self.slopes, self.smooth = system, name == "slopes", name == "smooth"
        self.memory = m = Memory(b, self.slopes)
        n = self.n = system.n
        self.spread = emit_transition(module, system, slopes=self.slopes)
        self.p, self.x, self.gains = m.room(n * n), m.room(n), m.room(system.k * gain_width(n))
        self.span = b.alloca(VEC, I64(1))
        self.flag = b.alloca(I64, I64(1))

    @property
    def kept(self) -> int:
        return kept(self.system)

    def matrices(self, node: ir.Value) -> tuple[ir.Value, ir.Value]:
        b, size = self.b, self.n * self.n
        phi = self.memory.at(self.a["table"], b.mul(node, I64(2 * size)))
        return phi, self.memory.at(phi, size)

    def begin(self, group: ir.Value) -> None:
        """Matrices of all steps, and the covariance at the first sample."""
        b, m, a, n = self.b, self.memory, self.a, self.n
        own = m.at(a["parameters"], b.mul(group, I64(self.system.p)))
        self.variances = m.at(a["variances"], b.mul(group, I64(self.system.k)))
        steps = Loop(b, a["steps"], [], "steps")
        store(b, splat(b, b.load(b.gep(a["spans"], [steps.index]))), self.span, 0)
        b.call(self.spread, [own, self.span, *self.matrices(steps.index)])
        steps.close([])
        m.clear(self.p, n * n)
        for i in range(n - self.system.own, n):
            m.put(1.0, self.p, i * n + i)
        m.clear(self.x, n)
        b.store(I64(0), self.flag)
        with b.if_then(b.icmp_signed("!=", a["lead"], I64(0))):
            phi, q = self.matrices(b.sub(a["steps"], I64(1)))
            predict_covariance(m, n, self.p, phi, q)


def kept(system: StateSpace) -> int:
    """Numbers of a sample that smoothing wants: gains, residuals, state, covariance."""
    n = system.n
    return system.k * (n + 1) + n + n * n


def _emit_revise(module: ir.Module, system: StateSpace, *, slopes: bool) -> ir.Function:
    """`revise(p, gains, variances, phi, q, seen, weights, flag)`: an update and a prediction."""
    n = system.n
    made = function(module, "revise", 0, [VECTORS] * 5 + [NUMBERS, NUMBERS, WHOLE])
    p, gains, variances, phi, q, seen, weights, flag = made.args
    b = ir.IRBuilder(made.append_basic_block())
    memory = Memory(b, slopes)
    old = [dual(memory.get(p, i * n + i)) for i in range(n)]
    for k in range(system.k):
        is_seen = Lane(b, splat(b, b.load(b.gep(seen, [I64(k)]))))
        update_covariance(memory, system, k, p, variances, gains, weights, is_seen)
    predict_covariance(memory, n, p, phi, q)
    moving = _moving(memory, n, p, old)
    b.store(b.select(anywhere(b, moving), I64(0), I64(1)), flag)
    b.ret_void()
    return made


def _moving(memory: Memory, n: int, p: ir.Value, old: list[Dual]) -> ir.Value:
    """Lanes in which a variance changes still."""
    b = memory.b
    absolute = intrinsic(b.module, f"llvm.fabs.v{LANES}f64", VEC, [VEC])
    moving = ir.Constant(ir.VectorType(ir.IntType(1), LANES), [0] * LANES)
    for i, before in enumerate(old):
        now = dual(memory.get(p, i * n + i))
        far = b.call(absolute, [(now.value - before.value).value])
        near = (now.value * SAME).value
        moving = b.or_(moving, b.fcmp_unordered(">", far, near))
        if memory.slopes:
            far = b.call(absolute, [(now.slope - before.slope).value])
            size = Lane(b, b.call(absolute, [now.slope.value])) + now.value
            moving = b.or_(moving, b.fcmp_unordered(">", far, (size * SAME_SLOPE).value))
    return moving


def _emit_filter(module: ir.Module, system: StateSpace, name: str) -> None:
    revise = _emit_revise(module, system, slopes=name == "slopes")
    w = _Writer(module, system, name)
    b, a, m, n = w.b, w.a, w.memory, w.n
    groups = Loop(b, a["groups"], [], "groups")
    w.begin(groups.index)
    samples = Loop(b, a["samples"], [], "samples")
    t = samples.index
    here = b.mul(b.add(b.mul(groups.index, a["samples"]), t), I64(system.k))
    if w.smooth:
        keep = m.at(a["kept"], b.mul(t, I64(w.kept)))
        emit_copy(b, w.x, b.gep(keep, [I64(system.k * (n + 1))]), n)
        emit_copy(b, w.p, b.gep(keep, [I64(system.k * (n + 1) + n)]), n * n)
    phi, q = w.matrices(b.load(b.gep(a["node"], [t])))
    settled = b.and_(b.load(w.flag), b.load(b.gep(a["same"], [t])))
    seen = b.gep(a["seen"], [b.mul(t, I64(system.k))])
    with b.if_then(b.icmp_signed("==", settled, I64(0))):
        b.call(revise, [w.p, w.gains, w.variances, phi, q, seen, a["weights"], w.flag])
    _emit_sample(w, here, t, phi)
    samples.close([])
    if w.smooth:
        _emit_back(w, groups.index)
    groups.close([])
    b.ret_void()


def _emit_sample(w: _Writer, here: ir.Value, t: ir.Value, phi: ir.Value) -> None:
    """Update the state by a sample, and predict the next."""
    b, m, n, system = w.b, w.memory, w.n, w.system
    left, state = m.at(w.a["left"], here), m.row(w.x, n)
    out = m.at(w.a["out"], b.mul(here, I64(2)))
    for k in range(system.k):
        at = k * gain_width(n)
        y, weights = m.get(left, k), w.a["weights"]
        innovation, state = update_state(m, system, k, state, y, w.gains, weights)
        over = inverse_deviation(m, n, k, w.gains)
        white = innovation * over
        if w.smooth:
            keep = m.at(w.a["kept"], b.mul(t, I64(w.kept)))
            for i in range(n):
                m.put(m.get(w.gains, at + i), keep, k * (n + 1) + i)
            m.put(white * over, keep, k * (n + 1) + n)
        else:
            m.put(white, out, 2 * k)
            m.put(m.get(w.gains, at + n), out, 2 * k + 1)
    rows = [[m.get(phi, i * n + j) for j in range(n)] for i in range(n)]
    for i, row in enumerate(rows):
        m.put(dot(row, state), w.x, i)


def _emit_back(w: _Writer, group: ir.Value) -> None:
    """The smoother, from the last sample to the first."""
    b, a, m, n, system = w.b, w.a, w.memory, w.n, w.system
    back = Loop(b, a["samples"], [vector(0.0)] * n, "back")
    t = b.sub(b.sub(a["samples"], I64(1)), back.index)
    adjoint: list[Number] = [Lane(b, one) for one in back.carried]
    keep = m.at(a["kept"], b.mul(t, I64(w.kept)))
    for k in reversed(range(system.k)):
        gain = [m.get(keep, k * (n + 1) + i) for i in range(n)]
        more = m.get(keep, k * (n + 1) + n) - dot(gain, adjoint)
        for i, weight in system.weights(b, a["weights"], k).items():
            adjoint[i] = fused(weight, more, adjoint[i])
    first = system.k * (n + 1)
    out = m.at(a["out"], b.mul(b.add(b.mul(group, a["samples"]), t), I64(n)))
    for i in range(n):
        row = [m.get(keep, first + n + i * n + j) for j in range(n)]
        m.put(dot(row, adjoint, m.get(keep, first + i)), out, i)
    before = b.select(b.icmp_signed(">", t, I64(0)), b.sub(t, I64(1)), I64(0))
    phi, _ = w.matrices(b.load(b.gep(a["node"], [before])))
    columns = [[m.get(phi, j * n + i) for j in range(n)] for i in range(n)]
    back.close([dot(column, adjoint).value for column in columns])


def _emit_draw(module: ir.Module, system: StateSpace, name: str) -> None:
    """States, and what channels show of them with noise, of numbers that are standard normal."""
    factor = emit_factor(module, system.n)
    w = _Writer(module, system, name)
    b, a, m, n = w.b, w.a, w.memory, w.n
    groups = Loop(b, a["groups"], [], "groups")
    w.begin(groups.index)
    first = m.room(n * n)
    b.call(factor, [first, w.p])
    steps = Loop(b, a["steps"], [], "factors")
    _, q = w.matrices(steps.index)
    spare = m.room(n * n)
    b.call(factor, [spare, q])
    emit_copy(b, spare, q, n * n)
    steps.close([])
    samples = Loop(b, a["samples"], [vector(0.0)] * n, "samples")
    t, k_count = samples.index, system.k
    here = b.mul(b.add(b.mul(groups.index, a["samples"]), t), I64(n + k_count))
    normals = m.row(m.at(a["left"], here), n + k_count)
    before = b.select(b.icmp_signed(">", t, I64(0)), b.sub(t, I64(1)), I64(0))
    phi, q = w.matrices(b.load(b.gep(a["node"], [before])))
    begins = b.icmp_signed("==", t, I64(0))
    spreads = b.select(begins, first, q)
    state: list[Number] = []
    for i in range(n):
        moved = dot(
            [m.get(phi, i * n + j) for j in range(n)], [Lane(b, x) for x in samples.carried]
        )
        spread = [m.get(spreads, i * n + j) for j in range(i + 1)]
        state.append(dot(spread, normals[: i + 1], moved))
    out = m.at(a["out"], here)
    for i, one in enumerate(state):
        m.put(one, out, i)
    for k in range(k_count):
        size = Lane(b, root(b, load(b, w.variances, k)))
        value = size * normals[n + k]
        for i, weight in system.weights(b, a["weights"], k).items():
            value = fused(weight, state[i], value)
        m.put(value, out, n + k)
    samples.close([one.value for one in state])
    groups.close([])
    b.ret_void()
