"""Provide tools for all subpackages: errors, registries, symbols, units, formulas, dual numbers.

No module here writes a file, draws a figure, or depends on a command of the command line. Other
subpackages write files through `bayesdrill.output_files`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.registry import lazy_attributes

if TYPE_CHECKING:
    from bayesdrill.basics.arrays import Array as Array
    from bayesdrill.basics.entries import Count as Count
    from bayesdrill.basics.entries import Positive as Positive
    from bayesdrill.basics.errors import InputError as InputError
    from bayesdrill.basics.errors import Interrupted as Interrupted
    from bayesdrill.basics.errors import Issue as Issue
    from bayesdrill.basics.errors import did_you_mean as did_you_mean
    from bayesdrill.basics.progress import Reporter as Reporter
    from bayesdrill.basics.progress import Silent as Silent
    from bayesdrill.basics.symbols import PARAMETERS as PARAMETERS
    from bayesdrill.basics.symbols import STATES as STATES
    from bayesdrill.basics.symbols import Symbol as Symbol
    from bayesdrill.basics.symbols import own_symbol as own_symbol

__getattr__ = lazy_attributes(__name__)
