"""Compiled kernels: a matrix exponential and a recurrence, eight walkers side by side.

The kernels are written for one rig in one experiment: its formulas, the number of states, the
entries that can differ from zero, the channels and the hold of the inputs are constants of the
generated code, and every scalar of the recurrence is a vector of `LANES` walkers that stays in
registers over all samples.  LLVM (through llvmlite) compiles them for the processor at hand in
about 0.2 s; no compiler has to be installed and nothing is cached on disk.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir

from bayesdrill.kernels.exponential import emit_exponential
from bayesdrill.kernels.lanes import LANES
from bayesdrill.kernels.layout import Layout
from bayesdrill.kernels.recurrence import emit_response

__all__ = ["LANES", "Kernels", "Layout", "compile_kernels"]


@dataclass(frozen=True, slots=True)
class Kernels:
    """`misfit(G, T, parameters, y, u, out)` and `signals(...)` for G groups of LANES walkers.

    All arguments but counts are addresses of C-contiguous blocks: `parameters (G, P, LANES)`,
    `y (T, K)`, `u (T + 1, n_series)`.  `misfit` writes sums of squares `(G, K, LANES)`, `signals`
    `(G, T, K, LANES)`; a lane whose numbers overflow gets NaN.  `misfit` is None where it was not
    wanted.
    """

    misfit: Callable[..., None] | None
    signals: Callable[..., None]
    engine: Any  # owns the machine code


def compile_kernels(layout: Layout, *, sums: bool = True) -> Kernels:
    """`sums`: with `misfit`."""
    module = ir.Module("bayesdrill")
    step = emit_exponential(module, layout, "step", layout.dt)
    lead = emit_exponential(module, layout, "lead", layout.lead) if layout.lead > 0.0 else None
    if sums:
        emit_response(module, layout, step, lead, sums=True)
    emit_response(module, layout, step, lead, sums=False)
    engine = _machine_code(module)
    prototype = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 2, *[ctypes.c_void_p] * 4)
    address = engine.get_function_address
    misfit = prototype(address("misfit")) if sums else None
    return Kernels(misfit, prototype(address("signals")), engine)


def _machine_code(module: ir.Module) -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=3
    )
    parsed = llvm.parse_assembly(str(module))
    parsed.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    passes = llvm.create_pass_builder(target, options)
    passes.getModulePassManager().run(parsed, passes)
    engine = llvm.create_mcjit_compiler(parsed, target)
    engine.finalize_object()
    return engine
