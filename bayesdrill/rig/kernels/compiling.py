"""Compile kernels for the present processor, once for each structure.

A kernel is written in LLVM's language. It is compiled only if its machine code is neither in memory
nor in the cache of the user. Its key is a text of all that the code depends on: the structures for
which it is specialised, the model's formulas as code, and all that writes and compiles it.
"""

from __future__ import annotations

import ctypes
import gc
import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from bayesdrill.basics import duals
from bayesdrill.rig.kernels.cache import CodeCache, user_cache
from bayesdrill.rig.kernels.lanes import LANES, Module

# The passes of LLVM from which a kernel gains. It has no superfluous branches, calls no small
# functions, and its loops are already over vectors. All other passes would double the time to
# compile, and the code would run no faster.
PASSES = ("sroa", "instruction_combine", "simplify_cfg")
# LLVM's optimisation level. The higher one takes a quarter more time to compile. It gains 2 to 3 % in
# kernels of few loops that keep the processor's arithmetic busy, and nothing in the others.
OPT_LEVEL, HIGH_OPT_LEVEL = 1, 2
Argument = NDArray[Any] | int  # a block, or a count, or the address of a block
PIECE = 4096  # numbers of a walker that are copied at once, so that groups stay in the cache


@dataclass(frozen=True, slots=True)
class Kernel:
    """The kernel has functions by name, the names of their `arguments`, and their machine code."""

    functions: Mapping[str, Callable[..., None]]
    arguments: Mapping[str, Sequence[str]]
    engine: Any = field(repr=False)

    def bind(self, name: str, **given: Argument) -> BoundFunction:
        """Return a function with the arguments that are the same in all calls; others are zero."""
        places = {argument: place for place, argument in enumerate(self.arguments[name])}
        values = [address(given.get(argument, 0)) for argument in places]
        return BoundFunction(self, self.functions[name], values, places, given)


@dataclass(frozen=True, slots=True)
class BoundFunction:
    """A function of a kernel has `values` of its arguments, at their `places`.

    Values are counts and addresses of blocks. To ask a block for its address takes as long as
    simulating some samples, so it is done once for blocks that are the same in all calls.
    """

    kernel: Kernel  # kept, as is its machine code
    function: Callable[..., None]
    values: list[int]
    places: Mapping[str, int]
    blocks: Mapping[str, Argument]  # kept, so that their addresses stay valid

    def __call__(self, **given: Argument) -> None:
        """Call the function with further counts and blocks."""
        values = self.values.copy()
        for name, argument in given.items():
            number = argument if isinstance(argument, int) else address(argument)
            values[self.places[name]] = number
        self.function(*values)

    def run(self, n: int, shape: tuple[int, ...], **given: Argument) -> NDArray[np.float64]:
        """Return the results for n walkers, `(n, *shape)`, from the function's block `out`."""
        out = np.empty((-(-n // LANES), math.prod(shape), LANES))
        self(groups=len(out), out=out, **given)
        return rows_of_walkers(out, n).reshape(n, *shape)


def address(argument: Argument) -> int:
    """Return the address of a contiguous block; a count or an address is returned as it is."""
    if isinstance(argument, int):
        return argument
    try:  # four times as fast as the attribute `ctypes`
        return ctypes.addressof(ctypes.c_char.from_buffer(argument))
    except (TypeError, ValueError):  # of a block that is read-only or empty
        return argument.ctypes.data


def rows_of_walkers(out: NDArray[np.float64], n: int) -> NDArray[np.float64]:
    """Return `(n, M)` of n walkers in groups `(G, M, LANES)`; long rows are copied in pieces."""
    size = out.shape[1]
    if size <= PIECE:
        return out.transpose(0, 2, 1)[:, :n].reshape(-1, size)[:n]
    rows = np.empty((n, size))
    for group, first in product(range(len(out)), range(0, size, PIECE)):
        piece, part = slice(first, first + PIECE), rows[LANES * group :][:LANES]
        part[:, piece] = out[group, piece, : len(part)].T
    return rows


@cache
def compile_kernel(write: Callable[..., None], *structures: Any, effort: int = OPT_LEVEL) -> Kernel:
    """Return the kernel that `write(module, *structures)` writes, from the cache if it is there.

    Structures are hashable. The `text` of a structure has all of it that the code depends on, and
    is equal if the code is. Some structures are plain names.
    """
    texts = [
        structure if isinstance(structure, str) else structure.text for structure in structures
    ]
    key = "\n".join([write.__qualname__, *_toolchain(effort), *texts])
    cache = user_cache() if _sources() else CodeCache(None)
    code = cache.load(key)
    if code is None:
        with _no_garbage_collection():
            module = Module(write.__module__)
            write(module, *structures)
            # A line before the machine code lists the arguments of each function.
            line = json.dumps(module.arguments).encode() + b"\n"
            code = line + machine_code(module, effort)
        cache.store(key, code)
    return _unpack(code)


def _toolchain(effort: int) -> list[str]:
    """Return all that the code of a kernel depends on, apart from its structures."""
    import llvmlite
    import llvmlite.binding as llvm

    versions = (
        f"llvmlite {llvmlite.__version__}, LLVM {llvm.llvm_version_info}, numpy {np.__version__}"
    )
    passes = f"{', '.join(PASSES)}; effort {effort}"
    return [_sources(), versions, passes, llvm.get_default_triple(), *_processor()]


@cache
def _sources() -> str:
    """Return the digest of all modules that write kernels, and of numbers with slopes.

    It is empty if they cannot be read, as in a package that is not unpacked.
    """
    digest = hashlib.sha256()
    try:
        rig = Path(__file__).parents[1]
        writers = [*rig.glob("kernels/*.py*"), *rig.glob("compression/*.py*")]
        for path in (*sorted(writers), Path(duals.__file__)):
            digest.update(path.name.encode() + path.read_bytes())
    except OSError:
        return ""
    return digest.hexdigest()


def _processor() -> tuple[str, str]:
    """Return the name of the processor, and its features."""
    import llvmlite.binding as llvm

    return llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()


def _unpack(packed: bytes) -> Kernel:
    line, _, code = packed.partition(b"\n")
    engine = link_code(code)
    functions, arguments = {}, json.loads(line)
    for name, names in arguments.items():
        prototype = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * len(names))
        functions[name] = prototype(engine.get_function_address(name))
    return Kernel(functions, arguments, engine)


def machine_code(module: ir.Module, effort: int = OPT_LEVEL) -> bytes:
    """Compile `module` for this processor into an object file."""
    import llvmlite.binding as llvm

    target = _target(effort)
    # A context of its own, as constants stay in memory while it lives.
    context = llvm.create_context()
    parsed = llvm.parse_assembly(str(module), context)
    parsed.verify()
    passes = llvm.create_new_module_pass_manager()
    for name in PASSES:
        getattr(passes, f"add_{name}_pass")()
    passes.run(parsed, llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options()))
    code: bytes = target.emit_object(parsed)
    return code


def link_code(code: bytes) -> Any:
    """Return the engine with the functions of an object file, ready to be called.

    The engine has machine code alone. An LLVM module and a target that has compiled take ten times
    as much memory, and would stay as long as the code.
    """
    import llvmlite.binding as llvm

    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


def _target(effort: int = OPT_LEVEL) -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    name, features = _processor()
    triple = llvm.Target.from_default_triple()
    return triple.create_target_machine(cpu=name, features=features, opt=effort)


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Stop garbage collection: a module is many small objects, none of them garbage yet."""
    looking = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if looking:
            gc.enable()
