"""Load what workers search, walk and draw with; only workers and their server import this."""

import gc
import importlib
import sys
from contextlib import suppress
from types import TracebackType

# Optional parts of corner and emcee, which no worker uses, take longer to load than all others.
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
    """Print an exception, unless a semaphore is missing: its parent ended before this one began."""
    if kind is not FileNotFoundError:
        sys.__excepthook__(kind, error, traceback)


sys.excepthook = _say
sys.modules.update(dict.fromkeys(UNUSED))  # type: ignore[arg-type]
for _name in NEEDED:
    with suppress(Exception):  # the task that needs it tells of it
        importlib.import_module(_name)
del sys.modules["scipy.stats"]  # some figures use it
gc.freeze()  # searches for cycles pass over what is loaded, so that workers share its memory
