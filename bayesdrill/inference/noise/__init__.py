"""Register the kinds of noise: add a file and a line here, or an entry point `bayesdrill.noise`."""

from __future__ import annotations

from typing import Any

from bayesdrill.basics.entries import entries_model
from bayesdrill.basics.registry import Registry
from bayesdrill.inference.noise.ar1 import AR1
from bayesdrill.inference.noise.contract import NoiseKind
from bayesdrill.inference.noise.quantised import Quantised
from bayesdrill.inference.noise.student_t import StudentT
from bayesdrill.inference.noise.white import White


def _is_noise(_: str, member: Any) -> None:
    missing = [name for name in ("from_channels", "Entries") if not hasattr(member, name)]
    if missing:
        names = ", ".join(missing)
        raise ValueError(f"it has no {names}; see `bayesdrill.inference.noise.contract`")
    entries_model(member.Entries)


NOISES: Registry[NoiseKind] = Registry(
    "noise",
    {"white": White, "ar1": AR1, "student_t": StudentT, "quantised": Quantised},
    judge=_is_noise,
)
