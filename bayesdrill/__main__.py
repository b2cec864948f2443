"""`python -m bayesdrill`, and the command `bayesdrill`."""

from __future__ import annotations

import signal


def main() -> None:
    # Before a command begins there is nothing to save or to say: Ctrl-C just ends the process.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from bayesdrill.cli import main as run

    run()


if __name__ == "__main__":
    main()
