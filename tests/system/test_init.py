"""`bayesdrill init RECORD`: tables of any size are read in seconds, or refused."""

import time
from pathlib import Path

import numpy as np
from support import command_line
from support.case_tables import run_cases
from support.command_line import assert_refused

SECONDS = 15.0  # of the processor; each of these took minutes once
HEAD = "t,w_1\n" + "\n".join(f"{k / 100},{k % 7}" for k in range(40))
TABLES = {
    "one line": ("1.5," * 1_500_000, "at most 200000 are read"),
    "one cell": (f"{HEAD}\n0.4,{'1' * 6_000_000}\n", "at most 200000 are read"),
    "one head": (HEAD.replace("w_1", "w [" * 2_000_000), "at most 200000 are read"),
    "digits": (HEAD.replace(",3", f",{'3' * 190_000}"), "is not a number"),
    "brackets": ("t w" + " [x" * 60_000 + "\n" + "1 2\n" * 30, "odd.csv"),
    "blanks": (HEAD.replace("w_1", f"w{' ' * 190_000}["), "odd.csv"),
    "5,000 columns": (
        ",".join(f"x_{k}" for k in range(5000)) + ("\n" + "1,2,3,4," * 1250) * 30,
        "300 columns at most",
    ),
}


@run_cases("name", TABLES)
def test_a_table_of_odd_proportions_is_refused_in_seconds(name: str, tmp_path: Path) -> None:
    text, message = TABLES[name]
    (tmp_path / "odd.csv").write_text(text)
    start = time.process_time()
    result = command_line.cli("init", tmp_path / "odd.csv")
    assert time.process_time() - start < SECONDS
    assert_refused(result, message)
    assert max(map(len, result.err.splitlines())) <= 400


@run_cases("what", ["samples", "bytes"])
def test_init_says_how_much_it_reads(what: str, tmp_path: Path) -> None:
    path = tmp_path / "long.npz"
    if what == "samples":
        np.savez_compressed(path, t=np.arange(1e6 + 1), w_1=np.zeros(1_000_001))
    else:
        with path.open("wb") as file:
            file.truncate(200_000_000)
    messages = {"samples": "looks at 1000000 samples", "bytes": "has 200 MB; at most 100 MB"}
    result = command_line.cli("init", path)
    assert_refused(result, messages[what])
    assert result.err.count("\n") == 1
