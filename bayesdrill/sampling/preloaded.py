"""Load the modules of workers; only workers and their server import this module."""

import gc
import importlib
import sys
from contextlib import suppress
from types import TracebackType

# Workers do not use optional parts of corner and emcee, which load more slowly than all else.
UNUSED = ("arviz", "scipy.stats")
NEEDED = (
    "emcee",
    "corner",
    "matplotlib.backends.backend_agg",
    "matplotlib.backends.backend_pdf",
    "scipy.linalg",
    "scipy.optimize",
    "bayesdrill.report.publish",
)


def _say(kind: type[BaseException], error: BaseException, traceback: TracebackType | None) -> None:
    """Print an exception, unless a semaphore is missing because the parent has already ended."""
    if kind is not FileNotFoundError:
        sys.__excepthook__(kind, error, traceback)


sys.excepthook = _say
gc.disable()  # modules are no garbage
sys.modules.update(dict.fromkeys(UNUSED))  # type: ignore[arg-type]
for _name in NEEDED:
    with suppress(Exception):  # a task that needs the module reports the error
        importlib.import_module(_name)
del sys.modules["scipy.stats"]  # some figures load it
with suppress(Exception):  # short formulas are parsed twice as fast without remembered results
    importlib.import_module("pyparsing").ParserElement.disable_memoization()
gc.freeze()  # no garbage collection of loaded modules, so that workers share their memory
gc.enable()
