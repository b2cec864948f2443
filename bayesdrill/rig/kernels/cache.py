"""Keep the machine code of kernels between processes, in a folder to which only the user has access.

The files are executed. So a folder or a file is not used if other users own it, or may read or
write it. If machine code cannot be loaded or stored, that is no error: the kernel is compiled
again.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import secrets
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

CACHE_VARIABLE = "BAYESDRILL_CACHE"  # environment variable: another folder, or `CACHE_OFF`
CACHE_OFF = "off"  # switches the cache off, as `0` does
MAX_FILES, MAX_BYTES = 4000, 256 * 1024**2  # upper limits of the whole cache
_DIGEST_BYTES = hashlib.sha256().digest_size
# Names of the cache's files; files with other names are never touched.
_NAMES = re.compile(r"[0-9a-f]{64}(\.[0-9a-f]+\.tmp)?")
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class CodeCache:
    """The cache has one file in `folder` for the code of each key; without a folder it stays empty."""

    folder: Path | None
    max_files: int = MAX_FILES
    max_bytes: int = MAX_BYTES

    def load(self, key: str) -> bytes | None:
        """Return the code stored under `key`; None if its file is missing, damaged or not private."""
        try:
            with self._opened() as folder, _owned_file(_name(key), folder) as file:
                content = file.read()
                with suppress(OSError):  # mark as used just now, so that others are removed first
                    os.utime(file.fileno())
        except FileNotFoundError:
            return None
        except OSError as error:
            _log.debug("code is not read from %s: %s", self.folder, error)
            return None
        code = content[_DIGEST_BYTES:]
        if content[:_DIGEST_BYTES] != _digest(key, code):
            _log.debug("code of %s in %s is damaged", _name(key), self.folder)
            return None
        return code

    def store(self, key: str, code: bytes) -> None:
        """Store `code` under `key`, completely or not at all; remove files beyond the limits."""
        try:
            with self._opened(create=True) as folder:
                _write(_name(key), _digest(key, code) + code, folder)
                self._prune(folder)
        except OSError as error:
            _log.debug("code is not kept in %s: %s", self.folder, error)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Return the size of each file [bytes]; raises `OSError` if the folder is refused."""
        try:
            with self._opened() as folder:
                return tuple(status.st_size for status in _files(folder).values())
        except FileNotFoundError:
            return ()

    def clear(self) -> None:
        """Remove all files of the cache; raises `OSError` if that is impossible."""
        with suppress(FileNotFoundError), self._opened() as folder:
            for name in _files(folder):
                os.unlink(name, dir_fd=folder)

    @contextmanager
    def _opened(self, *, create: bool = False) -> Iterator[int]:
        """Open the folder; yield its descriptor, which refers to the checked folder even if it is moved.

        Raises `FileNotFoundError` if there is no folder, and `PermissionError` if other users have
        access to it.
        """
        # Only systems with these functions can check owner and permissions of an opened folder.
        supported = hasattr(os, "geteuid") and os.open in os.supports_dir_fd
        if self.folder is None or not supported:
            raise FileNotFoundError(
                f"code is not kept: {CACHE_VARIABLE}={CACHE_OFF}, or owners cannot be checked"
            )
        if create:
            self.folder.parent.mkdir(parents=True, exist_ok=True)
            with suppress(FileExistsError):
                self.folder.mkdir(mode=0o700)
        folder = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            status = os.fstat(folder)
            if status.st_uid != os.geteuid() or stat.S_IMODE(status.st_mode) & 0o777 != 0o700:
                raise PermissionError(
                    "it belongs to another user, or others have access to it (`chmod 700` removes that)"
                )
            yield folder
        finally:
            os.close(folder)

    def _prune(self, folder: int) -> None:
        """Remove the least recently used files until the limits hold."""
        files = sorted(_files(folder).items(), key=lambda item: -item[1].st_mtime_ns)
        total = 0
        for count, (name, status) in enumerate(files, start=1):
            total += status.st_size
            if count > self.max_files or total > self.max_bytes:
                with suppress(FileNotFoundError):  # another process may have removed the file
                    os.unlink(name, dir_fd=folder)


def user_cache(environment: Mapping[str, str] = os.environ) -> CodeCache:
    """Return the cache in the folder that `CACHE_VARIABLE` names, or else in the system's folder."""
    named = environment.get(CACHE_VARIABLE, "")
    if named.lower() in (CACHE_OFF, "0"):
        return CodeCache(None)
    if named:
        with suppress(RuntimeError):  # `~` without a home folder is an ordinary name
            named = str(Path(named).expanduser())
        return CodeCache(Path(named) / "kernels")
    from platformdirs import user_cache_path

    return CodeCache(user_cache_path("bayesdrill") / "kernels")


def _name(key: str) -> str:
    return hashlib.sha256(key.encode()).hexdigest()


def _digest(key: str, code: bytes) -> bytes:
    """Return the digest of key and code; code that is stored under another key counts as damaged."""
    return hashlib.sha256(_name(key).encode() + code).digest()


@contextmanager
def _owned_file(name: str, folder: int) -> Iterator[IO[bytes]]:
    """Open a file of the cache; raises `OSError` if other users have access to it."""
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
    with open(os.open(name, flags, dir_fd=folder), "rb") as file:
        status = os.fstat(file.fileno())
        owned = stat.S_ISREG(status.st_mode) and status.st_uid == os.geteuid()
        if not owned or status.st_mode & 0o077 or status.st_size > MAX_BYTES:
            raise PermissionError(f"{name} is too large, or not a private file of the user")
        yield file


def _write(name: str, content: bytes, folder: int) -> None:
    """Write a temporary file first, then rename it, so that a file is always complete."""
    temporary = f"{name}.{secrets.token_hex(8)}.tmp"
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
    try:
        with open(os.open(temporary, flags, 0o600, dir_fd=folder), "wb") as file:
            file.write(content)
        os.replace(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)
    except BaseException:
        with suppress(OSError):
            os.unlink(temporary, dir_fd=folder)
        raise


def _files(folder: int) -> dict[str, os.stat_result]:
    """Return the cache's files by name, including those that are being written."""
    files = {}
    with os.scandir(folder) as entries:
        for entry in entries:
            if _NAMES.fullmatch(entry.name):
                with suppress(FileNotFoundError):
                    files[entry.name] = entry.stat(follow_symlinks=False)
    return files
