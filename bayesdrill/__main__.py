"""`python -m bayesdrill`, and the command `bayesdrill`."""

from __future__ import annotations

import atexit
import gc
import signal
import sys

from bayesdrill.basics.errors import short_of_memory


def main() -> None:
    """Run the command line."""
    sys.modules["dask"] = None  # type: ignore[assignment]  # xarray would load it, for half a second
    atexit.register(gc.freeze)  # at its end the process goes as a whole: no search for cycles
    # Before a command begins there is nothing to save or to say: Ctrl-C just ends the process.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        from bayesdrill.cli import main as run

        run()
    except (MemoryError, ImportError) as error:  # of a command itself `guard` tells
        if not short_of_memory(error):
            raise
        sys.stderr.write("out of memory before anything began; end other programs\n")
        sys.exit(2)


if __name__ == "__main__":
    main()
