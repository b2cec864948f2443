"""Start the command line, as `python -m bayesdrill` or as the command `bayesdrill`."""

from __future__ import annotations

import atexit
import gc
import signal
import sys

from bayesdrill.basics.errors import short_of_memory


def main() -> None:
    """Run the command line."""
    atexit.register(gc.freeze)  # no search for reference cycles when the process ends
    # Until a command begins there is nothing to save or report, so Ctrl-C simply ends the process.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        from bayesdrill.cli import main as run

        run()
    except (MemoryError, ImportError) as error:  # `guard` reports errors of commands
        if not short_of_memory(error):
            raise
        sys.stderr.write("out of memory before the command began; close other programs\n")
        sys.exit(2)


if __name__ == "__main__":
    main()
