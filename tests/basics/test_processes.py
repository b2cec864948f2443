"""Workers, and the server that forks them, beside what else an application and its user have."""

import multiprocessing
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.command_line import ROOT

from bayesdrill.basics import processes
from bayesdrill.sampling.workers import shut_down, start_workers

pytestmark = pytest.mark.skipif(not processes.FORKED, reason="other systems start fresh processes")

# A script in another folder than the one in which it is started, whose child is forked.
SCRIPT = """
import multiprocessing
import os
import threading
from bayesdrill.sampling.workers import shut_down, start_workers

def main():
    pool = start_workers(2, os.getpid)
    ready = pool.submit(eval, "__import__('time').process_time()")
    held = pool.submit(eval, "[name for name in __import__('os').environ if 'SAFEPATH' in name]")
    print(ready.result() < 0.5, held.result())
    shut_down(pool, 1.0)  # a thread of the pool may hold a lock, which a forked child would wait for
    print(threading.active_count(), flush=True)

if __name__ == "__main__":
    main()
    child = multiprocessing.get_context("fork").Process(target=main)
    child.start()
    child.join()
"""


def test_workers_of_a_script_and_of_its_forked_child_import_nothing_from_the_current_folder(
    tmp_path: Path,
) -> None:
    (tmp_path / "corner.py").write_text("print('the file of the user runs', flush=True)")
    script = tmp_path / "scripts" / "script.py"
    script.parent.mkdir()
    script.write_text(SCRIPT)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore"}
    command = [sys.executable, str(script)]
    result = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=30
    )
    assert result.stdout == "True []\n1\n" * 2, result.stderr


def test_an_application_keeps_its_own_server_and_children() -> None:
    before = dict(os.environ)
    child = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60.0,))
    child.start()
    try:
        pool = start_workers(2, os.getpid)
        pool.submit(os.getpid).result()
        shut_down(pool, 0.0)
        assert child.is_alive()
    finally:
        child.kill()
        child.join()
    assert dict(os.environ) == before
    with multiprocessing.get_context("forkserver").Pool(1) as own:
        loaded = own.apply(eval, ("set(__import__('sys').modules)",))
    assert not {"arviz", processes.PRELOADED} & loaded


def test_workers_are_fresh_where_the_path_of_the_socket_is_too_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from bayesdrill.basics import forking

    long = tmp_path / ("x" * 100)
    long.mkdir()
    monkeypatch.setitem(multiprocessing.current_process()._config, "tempdir", str(long))
    monkeypatch.setattr(forking, "SERVER", forking.Server())
    assert processes.start_server() is processes.SPAWN
