"""Machine code of a module, for the processor at hand."""

from __future__ import annotations

import functools
import gc
from collections.abc import Callable
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir

# Of LLVM's passes, those that a kernel gains from: it is written without branches that could go, calls
# nothing small and has its loops over vectors already. All others take as long again as these, the
# machine code included, and it runs no faster after them.
PASSES = ("sroa", "instruction_combine", "simplify_cfg")
# Of how hard it looks for machine code: harder takes a quarter as long again, for 2 to 3 % in kernels of
# few loops that keep the processor's arithmetic busy, and nothing in the others.
EFFORT, HARDER = 1, 2


def machine_code(module: ir.Module, effort: int = EFFORT) -> Any:
    """An engine, which owns the code."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=effort
    )
    parsed = llvm.parse_assembly(str(module))
    parsed.verify()
    passes = llvm.create_new_module_pass_manager()
    for name in PASSES:
        getattr(passes, f"add_{name}_pass")()
    passes.run(parsed, llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options()))
    engine = llvm.create_mcjit_compiler(parsed, target)
    engine.finalize_object()
    return engine


def in_one_go[**P, T](write: Callable[P, T]) -> Callable[P, T]:
    """Without a look for garbage on the way: a module is many small things, of which none is any."""

    @functools.wraps(write)
    def undisturbed(*arguments: P.args, **named: P.kwargs) -> T:
        looking = gc.isenabled()
        gc.disable()
        try:
            return write(*arguments, **named)
        finally:
            if looking:
                gc.enable()

    return undisturbed
