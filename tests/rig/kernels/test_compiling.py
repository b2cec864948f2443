"""Compiled code takes little memory, and lives as long as what computes with it."""

import ctypes

import numpy as np
from llvmlite import ir
from support.case_tables import run_cases

from bayesdrill.rig.kernels.compiling import PIECE, link_code, machine_code, rows_of_walkers
from bayesdrill.rig.kernels.lanes import LANES

MANY = 20


def resident() -> float:
    """Memory of this process in MB."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096 / 1e6


def doubling() -> ir.Module:
    """A module whose function `twice` doubles a number."""
    module, number = ir.Module("doubling"), ir.DoubleType()
    made = ir.Function(module, ir.FunctionType(number, [number]), "twice")
    b = ir.IRBuilder(made.append_basic_block())
    b.ret(b.fmul(made.args[0], number(2.0)))
    return module


def test_compiled_code_takes_little_memory() -> None:
    """Without the compiler's own tables, 0.8 MB an engine and 2 to 5 of those of a rig."""
    code = machine_code(doubling())
    first = link_code(code)
    before = resident()
    engines = [link_code(code) for _ in range(MANY)]
    assert resident() - before < 0.3 * MANY
    kind = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)
    for engine in (first, *engines):
        assert kind(engine.get_function_address("twice"))(1.5) == 3.0


@run_cases("n", (1, 8, 9, 20))
def test_each_walker_gets_the_row_of_its_own_lane(n: int) -> None:
    """Long rows are copied in pieces.  Mutant killed: each group takes the rows of the first."""
    rng, size = np.random.default_rng(3), 2 * PIECE + 77
    out = rng.random((-(-n // LANES), size, LANES))
    rows = rows_of_walkers(out, n)
    assert rows.shape == (n, size)
    for walker, row in enumerate(rows):
        assert np.array_equal(row, out[walker // LANES, :, walker % LANES])
