"""The arithmetic floor of one evaluation: its operations at the speed of this processor.

Counted: the vector operations (on `LANES` walkers at once) that the kernel's formulas ask for, one
each for a fused multiplication and addition, an addition or a multiplication.  Measured: how many
independent ones of them a core finishes per second.  Loads, the loops and NumPy around it are not
counted, so that nothing in this form can be faster.
"""

from __future__ import annotations

import ctypes
import time

import llvmlite.binding as llvm
import numpy as np

from bayesdrill.rig.kernels import lanes
from bayesdrill.rig.kernels.exponential import TAYLOR_DEGREE, TAYLOR_NORM, Layout
from bayesdrill.rig.kernels.lanes import LANES

CHAINS = 16  # independent sums: more than a core needs to hide what one operation takes
ROUNDS = 20_000_000


def operations(
    layout: Layout, weights: np.ndarray, dt: float, n_samples: int, numbers: np.ndarray
) -> float:
    """Vector operations of one group of walkers at `numbers (P + C,)`: parameters, constant inputs.

    `weights (K, X)`: of states in channels.
    """
    reach = np.array(layout.reachable)
    x = layout.n_states
    columns = [k for k in range(len(reach)) if k != x]
    step = sum(int(reach[i, columns].sum()) + 1 for i in range(x))
    channels = int((weights != 0).sum()) + len(weights)
    product = int(sum(np.sum(reach[i][:, None] & reach) for i in range(len(reach))))
    squarings = max(0, int(np.ceil(np.log2(_norm(layout, dt, numbers) / TAYLOR_NORM))))
    horner = TAYLOR_DEGREE // 4 - 1
    exponential = (3 + horner + squarings) * product + 4 * (horner + 1) * int(reach.sum())
    return n_samples * (step + channels) + exponential


def _norm(layout: Layout, dt: float, numbers: np.ndarray) -> float:
    matrix = np.zeros((layout.size, layout.size))
    for row, column, value in layout.entries(list(numbers)):
        matrix[row, column] += value * dt
    return float(np.abs(matrix[: layout.n_states, : layout.n_states]).sum(axis=1).max())


def operations_per_second() -> float:
    """Vector operations that one core finishes per second, the best of several tries."""
    module = lanes.Module("floor")
    with lanes.kernel(module, "work", ("count",), {"out": lanes.VECTORS}) as (a, b):
        start = [lanes.vector(1.0 + k) for k in range(CHAINS)]
        loop = lanes.Loop(b, a["count"], start, "rounds")
        factor, term = lanes.vector(0.999), lanes.vector(1e-3)
        sums = [b.fma(total, factor, term) for total in loop.carried]
        loop.close(sums)
        b.write_row(sums, a["out"])
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=3
    )
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(str(module)), target)
    engine.finalize_object()
    work = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_void_p)(
        engine.get_function_address("work")
    )
    place = np.empty(CHAINS * LANES)
    best = 0.0
    for _ in range(5):
        begun = time.perf_counter()
        work(ROUNDS // CHAINS, place.ctypes.data)
        best = max(best, ROUNDS / (time.perf_counter() - begun))
    return best


def seconds_per_evaluation(
    layout: Layout, weights: np.ndarray, dt: float, n_samples: int, numbers: np.ndarray
) -> float:
    return operations(layout, weights, dt, n_samples, numbers) / (LANES * operations_per_second())
