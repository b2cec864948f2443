"""Machine code of a module for the processor at hand, and what kernels are specialised for."""

from __future__ import annotations

import functools
import gc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

# Of LLVM's passes, those that a kernel gains from: it is written without branches that could go, calls
# nothing small and has its loops over vectors already. All others take as long again as these, the
# machine code included, and it runs no faster after them.
PASSES = ("sroa", "instruction_combine", "simplify_cfg")
# Of how hard it looks for machine code: harder takes a quarter as long again, for 2 to 3 % in kernels of
# few loops that keep the processor's arithmetic busy, and nothing in the others.
EFFORT, HARDER = 1, 2


def machine_code(module: ir.Module, effort: int = EFFORT) -> Any:
    """Compile `module` for this processor, and return the engine that owns the code.

    The engine holds machine code alone: a module of LLVM and a target that has compiled take ten times
    as much memory, and would stay as long as the code.
    """
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    context = llvm.create_context()  # constants stay in one as long as it lives
    parsed = llvm.parse_assembly(str(module), context)
    parsed.verify()
    target = _target(effort)
    passes = llvm.create_new_module_pass_manager()
    for name in PASSES:
        getattr(passes, f"add_{name}_pass")()
    passes.run(parsed, llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options()))
    code = llvm.ObjectFileRef.from_data(target.emit_object(parsed))
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target(effort))
    engine.add_object_file(code)
    engine.finalize_object()
    return engine


def _target(effort: int) -> llvm.TargetMachine:
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=effort
    )


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


Entries = Callable[[Sequence[Any]], Sequence[tuple[int, int, Any]]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """One rig in one experiment.

    `entries(parameters)`: (row, column, value) of the augmented N x N matrix, whose columns are
    X states, one constant input, `n_series` sampled inputs and, with a first-order hold, their
    increments; a place may come more than once.  `dt`: the sampling step.  `lead`: from the start
    `x0 (X,)` to the first sample, with constant inputs.  `channels`: weights `(K, X)`.
    """

    n_parameters: int
    n_states: int
    n_series: int
    first_order: bool
    entries: Entries
    dt: float
    lead: float
    x0: tuple[float, ...]
    channels: tuple[tuple[float, ...], ...]

    @property
    def size(self) -> int:
        return self.n_states + 1 + self.n_series * (2 if self.first_order else 1)

    @property
    def reach(self) -> tuple[tuple[bool, ...], ...]:
        """Entries of the exponential that can differ from zero."""
        return reach_of(self._pattern)

    @property
    def idle(self) -> tuple[bool, ...]:
        """Columns of zeros: on that nothing depends, and its own entry of the exponential is one."""
        return tuple(not column for column in self._pattern.any(axis=0))

    @property
    def _pattern(self) -> NDArray[np.bool_]:
        pattern = np.zeros((self.size, self.size), dtype=bool)
        for row, column, _ in self.entries([1.0] * self.n_parameters):
            pattern[row, column] = True
        return pattern


def reach_of(pattern: NDArray[np.bool_]) -> tuple[tuple[bool, ...], ...]:
    """Entries of exp(M) that can differ from zero, for M with the `pattern (N, N)`."""
    reach = pattern | np.eye(len(pattern), dtype=bool)
    for _ in range(len(pattern)):
        reach = reach | (reach.astype(int) @ reach.astype(int) > 0)
    return tuple(tuple(bool(entry) for entry in row) for row in reach)
