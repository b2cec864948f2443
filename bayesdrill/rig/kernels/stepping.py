"""Kernels of rigs that rub, or whose inputs are late: steps of one length, some to a sample."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from llvmlite import ir

from bayesdrill.rig.kernels.compiling import in_one_go, machine_code
from bayesdrill.rig.kernels.exponential import emit_exponential
from bayesdrill.rig.kernels.lanes import I64, VEC, Loop, function
from bayesdrill.rig.kernels.marching import Writer
from bayesdrill.rig.kernels.pieces import BLOCKS, COUNTS, Own, Shape
from bayesdrill.rig.kernels.reading import emit_reading, emit_trace

__all__ = ["BLOCKS", "COUNTS", "Kernel", "Own", "Shape", "compile_stepping"]


@dataclass(frozen=True, slots=True)
class Kernel:
    """A function of COUNTS and addresses of BLOCKS."""

    run: Callable[..., None]
    engine: Any  # owns the machine code


@lru_cache(maxsize=64)
@in_one_go
def compile_stepping(shape: Shape) -> Kernel:
    module = ir.Module("stepping")
    exponential = emit_exponential(module, shape.layout, "step", None)
    made = function(module, "stepping", len(COUNTS), list(BLOCKS.values()))
    b = ir.IRBuilder(made.append_basic_block())
    rooms = [b.alloca(VEC, I64(shape.layout.size**2)) for _ in range(2 + shape.strides)]
    w = Writer(b, shape, dict(zip([*COUNTS, *BLOCKS], made.args, strict=True)), tuple(rooms))
    groups = Loop(b, w.a["groups"], [], "groups")
    w.begin(groups.index, exponential)
    if shape.read:
        emit_trace(w)
        emit_reading(w)
    else:
        w.march()
    groups.close([])
    b.ret_void()
    engine = machine_code(module)
    kinds = [*[ctypes.c_int64] * len(COUNTS), *[ctypes.c_void_p] * len(BLOCKS)]
    return Kernel(ctypes.CFUNCTYPE(None, *kinds)(engine.get_function_address("stepping")), engine)
