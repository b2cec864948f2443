"""Compile kernels for the processor of this computer, once for each structure.

A kernel is written in LLVM's intermediate language. It is compiled only if its machine code is
neither in memory nor in the user's cache. The key of the code is a text of all that it depends on:
the structures for which it is specialised, the model's formulas as code, the sources of kernels,
the versions and settings of LLVM, and the processor.
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

# The passes of LLVM that make kernels faster. All other passes would double the time to compile
# without a gain: kernels have no superfluous branches or small functions, and are vectorised.
PASSES = ("sroa", "instruction_combine", "simplify_cfg")
# LLVM's optimisation levels. The higher level takes a quarter more time to compile. It makes only
# those kernels faster, by 2 to 3 %, that consist of few loops and are limited by arithmetic.
OPT_LEVEL, HIGH_OPT_LEVEL = 1, 2
Argument = NDArray[Any] | int  # a block, its address, or a count
PIECE = 4096  # numbers per walker that are copied at once, so that they fit into the cache


@dataclass(frozen=True, slots=True)
class Kernel:
    """The kernel has functions and the names of their `arguments`; `engine` has the machine code."""

    functions: Mapping[str, Callable[..., None]]
    arguments: Mapping[str, Sequence[str]]
    engine: Any = field(repr=False)

    def bind(self, name: str, **arguments: Argument) -> BoundFunction:
        """Return a function with these `arguments`; others are zero unless a call gives them."""
        places = {argument: place for place, argument in enumerate(self.arguments[name])}
        values = [address(arguments.get(argument, 0)) for argument in places]
        return BoundFunction(self, self.functions[name], values, places, arguments)


@dataclass(frozen=True, slots=True)
class BoundFunction:
    """A bound function has the `values` of a function's arguments; `positions` are their positions.

    Values are counts and addresses of blocks (arrays). Finding the address of a block takes as long as
    simulating some samples. So it is done once for blocks that are the same in all calls.
    """

    kernel: Kernel  # kept, so that its machine code stays in memory
    function: Callable[..., None]
    values: list[int]
    positions: Mapping[str, int]
    blocks: Mapping[str, Argument]  # kept, so that their addresses stay valid

    def __call__(self, **arguments: Argument) -> None:
        """Call the function with further counts and blocks."""
        values = self.values.copy()
        for name, argument in arguments.items():
            number = argument if isinstance(argument, int) else address(argument)
            values[self.positions[name]] = number
        self.function(*values)

    def run(self, n: int, shape: tuple[int, ...], **arguments: Argument) -> NDArray[np.float64]:
        """Call the function for n sets of parameters; return `(n, *shape)` from its block `out`."""
        out = np.empty((-(-n // LANES), math.prod(shape), LANES))
        self(groups=len(out), out=out, **arguments)
        return rows_of_walkers(out, n).reshape(n, *shape)


def address(argument: Argument) -> int:
    """Return the address of a contiguous block; a count or an address is returned as it is."""
    if isinstance(argument, int):
        return argument
    try:  # four times as fast as `argument.ctypes.data`
        return ctypes.addressof(ctypes.c_char.from_buffer(argument))
    except (TypeError, ValueError):  # the block is read-only or empty
        return argument.ctypes.data


def rows_of_walkers(out: NDArray[np.float64], n: int) -> NDArray[np.float64]:
    """Return the rows `(n, M)` of n walkers from groups `(G, M, LANES)`, copied in pieces if long."""
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
    """Return the kernel that `write(module, *structures)` writes, from the cache if possible.

    Structures are hashable. The `text` of a structure contains what the code depends on and nothing
    else, so that structures with equal texts share code. A structure may be a plain name.
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
    """Return all that the code of a kernel depends on, except its structures."""
    import llvmlite
    import llvmlite.binding as llvm

    versions = (
        f"llvmlite {llvmlite.__version__}, LLVM {llvm.llvm_version_info}, numpy {np.__version__}"
    )
    passes = f"{', '.join(PASSES)}; effort {effort}"
    return [_sources(), versions, passes, llvm.get_default_triple(), *_processor()]


@cache
def _sources() -> str:
    """Return the digest of the sources of all modules that write kernels, and of `duals`.

    It is empty if the sources cannot be read, as in a zipped package.
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
    # A separate context, because constants stay in memory as long as their context.
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

    The engine contains only machine code. The LLVM module and the target that compiled it take ten
    times as much memory, and an engine made from them would keep them.
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
    """Stop garbage collection, which would search the many small objects of a module in vain."""
    looking = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if looking:
            gc.enable()
