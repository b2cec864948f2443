"""The registry of noises: one file and one line here, or an entry point `bayesdrill.noise`."""

from __future__ import annotations

from bayesdrill.basics.registry import Registry
from bayesdrill.inference.noise.contract import Kind
from bayesdrill.inference.noise.white import White

NOISES: Registry[Kind] = Registry("noise", {"white": White})
