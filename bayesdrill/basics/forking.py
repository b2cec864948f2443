"""Fork worker processes from a fork server that only this package uses."""

from __future__ import annotations

import os
from multiprocessing import context, forkserver, popen_forkserver
from types import FunctionType
from typing import Any


class Server(forkserver.ForkServer):
    """The fork server serves one parent process, and is replaced if it cannot be reached."""

    read_signed = staticmethod(forkserver.read_signed)

    def __init__(self) -> None:
        super().__init__()
        self._owner = os.getpid()

    def ensure_running(self) -> None:
        """Start a new server after a fork of the parent process, or if the socket was removed.

        Many systems remove old temporary files, such as the socket, while a notebook is open.
        """
        address: Any = getattr(self, "_forkserver_address", None)
        if self._owner != os.getpid() or (address and not os.path.exists(address)):
            modules: Any = vars(self)["_preload_modules"]
            self.__init__()  # type: ignore[misc]
            self.set_forkserver_preload(modules)
        super().ensure_running()


SERVER = Server()


class _Popen(popen_forkserver.Popen):
    # `_launch` uses the server in the global variable `forkserver`; here this is `SERVER`.
    _launch = FunctionType(
        popen_forkserver.Popen._launch.__code__,  # type: ignore[attr-defined]
        {**vars(popen_forkserver), "forkserver": SERVER},
    )


class _Process(context.ForkServerProcess):
    @staticmethod
    def _Popen(process_obj: Any) -> _Popen:  # noqa: N802
        return _Popen(process_obj)


class _Context(context.ForkServerContext):
    Process = _Process


CONTEXT = _Context()
