"""Load the modules that workers need; only workers and their fork server import this module."""

import gc
import importlib
import sys
from contextlib import suppress
from types import TracebackType

# Workers do not need these optional dependencies of corner and emcee, which load slowly.
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
    """Print an exception, except if a semaphore is missing because the parent process has ended."""
    if kind is not FileNotFoundError:
        sys.__excepthook__(kind, error, traceback)


sys.excepthook = _say
gc.disable()  # loaded modules are kept, so that a collection would only take time
sys.modules.update(dict.fromkeys(UNUSED))  # type: ignore[arg-type]
for _name in NEEDED:
    with suppress(Exception):  # a task that needs the module reports the error
        importlib.import_module(_name)
del sys.modules["scipy.stats"]  # some figures import it later
with suppress(Exception):  # without memoization, short formulas are parsed twice as fast
    importlib.import_module("pyparsing").ParserElement.disable_memoization()
gc.freeze()  # later collections skip loaded modules, so that workers share their memory
gc.enable()
