"""Compiled kernels, eight walkers side by side: what every simulator computes in the end.

`recurrence` is for even times, `irregular` for uneven ones, `time_stepping` for friction,
`kalman_filter` for a latent torque. Nothing here knows an experiment: shapes and constants come
as arguments.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from llvmlite import ir

from bayesdrill.rig.kernels.compiling import Layout, in_one_go, machine_code
from bayesdrill.rig.kernels.exponential import emit_exponential
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.recurrence import emit_normal, emit_response, scratch_size
from bayesdrill.rig.kernels.sums import INTERVALS, LOGS, NEIGHBOURS, SQUARES, Tally

__all__ = ["LANES", "TALLIES", "Kernels", "Layout", "Tally", "compile_kernels", "scratch_size"]

TALLIES = {"misfit": SQUARES, "neighbours": NEIGHBOURS, "logs": LOGS, "intervals": INTERVALS}


@dataclass(frozen=True, slots=True)
class Kernels:
    """`misfit(G, T, parameters, y, u, out)` and `signals(...)` for G groups of LANES walkers.

    All arguments but counts are addresses of C-contiguous blocks: `parameters (G, P, LANES)`,
    `y (T, K)`, `u (T + 1, n_series)`.  `misfit` writes sums of squares `(G, K, LANES)`, `signals`
    `(G, T, K, LANES)`; a lane whose numbers overflow gets NaN.  Other `TALLIES` are as `misfit`, with as
    many numbers `(G, K, n, LANES)` as they have, and their weights `(K, m)` after the parameters.
    `normal`: see `kernels.normal`.  Those that were not wanted are missing.
    """

    named: Mapping[str, Callable[..., None]]
    engine: Any  # owns the machine code


@lru_cache(maxsize=64)
@in_one_go
def compile_kernels(layout: Layout, names: tuple[str, ...] = ("misfit", "signals")) -> Kernels:
    """Once for the same layout: several records of one rig share what is compiled."""
    module = ir.Module("bayesdrill")
    step = emit_exponential(module, layout, "step", layout.dt)
    lead = emit_exponential(module, layout, "lead", layout.lead) if layout.lead > 0.0 else None
    for name in names:
        if name == "normal":
            emit_normal(module, layout, step, lead)
        else:
            emit_response(module, layout, step, lead, name, TALLIES.get(name))
    engine = machine_code(module)
    named = {}
    for name in names:
        counts, blocks = (3, 7) if name == "normal" else (2, 4)
        prototype = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * counts, *[ctypes.c_void_p] * blocks)
        named[name] = prototype(engine.get_function_address(name))
    return Kernels(named, engine)
