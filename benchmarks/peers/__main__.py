"""One peer, in a process of its own: `python -m benchmarks.peers NAME BUDGET FILE`."""

from __future__ import annotations

import sys
from pathlib import Path

from benchmarks import problem
from benchmarks.peers import PEERS

if __name__ == "__main__":
    name, budget, file = sys.argv[1:]
    PEERS[name](problem.load(), float(budget)).save(Path(file))
