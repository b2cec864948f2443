"""A config becomes objects, or every mistake of it at once.

`schema/` says what may be written, `loading` reads it, `consistency/` finds what contradicts
itself, `records/` reads the files that are named, `resolve/` and `job` build the `Problem`.
Nothing here samples.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.registry import lazy_attributes

if TYPE_CHECKING:
    from bayesdrill.config.job import Job as Job
    from bayesdrill.config.records.simulation import simulate as simulate
    from bayesdrill.config.records.simulation import truth as truth
    from bayesdrill.config.records.sources import path_of as path_of
    from bayesdrill.config.resolve.assembly import optimiser as optimiser
    from bayesdrill.config.resolve.case import ResolvedCase as ResolvedCase

__getattr__ = lazy_attributes(__name__)
