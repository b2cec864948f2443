"""Turn a config into objects, or report all of its mistakes at once.

`schema/` defines the entries of a config, and `loading` reads them. `building/` makes objects
from the entries and finds contradictions. `records/` reads the files that a config names.
`assembly/` combines objects and records into a `Problem`. `job` calls these packages in this order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.registry import lazy_attributes

if TYPE_CHECKING:
    from bayesdrill.config.building.case import ResolvedCase as ResolvedCase
    from bayesdrill.config.building.settings import optimiser as optimiser
    from bayesdrill.config.job import Job as Job
    from bayesdrill.config.records.simulation import simulate as simulate
    from bayesdrill.config.records.simulation import truth as truth
    from bayesdrill.config.records.sources import path_of as path_of

__getattr__ = lazy_attributes(__name__)
