"""A config and a record each of whose texts would run in a browser, draw a table or obey a terminal."""

import csv
from pathlib import Path

from support import command_line

RUNS = "<img src=x onerror=owned=1>"  # where a page takes it for an element
LEAVES = '"><img src=x onerror="owned=1"><script>owned=1;document.title=1</script>'  # an attribute
OBEYED = "\x1b]0;owned\x07\x1b[2J[red]"
FILE = f"'{RUNS}`|$x_$&amp;.csv"  # no slash
COLUMNS = {"theta_1": f"{LEAVES}|[red]", "w_1": f"`{RUNS}` $x_$", "v": f"**{RUNS}** # {RUNS}"}
FORMULA = f"2*k_s # {LEAVES} | {OBEYED} $x_$ `{RUNS}`"
LATEX = f"x_{{{RUNS}}}"


def quoted(text: str) -> str:
    """As YAML has it between double quotes."""
    return '"' + "".join(f"\\U{ord(letter):08X}" for letter in text) + '"'


def small(folder: Path) -> Path:
    """The small experiment; unknowns are called as entities of HTML are."""
    config = command_line.small_config(
        folder,
        ("file: small.csv", f"file: {quoted(FILE)}"),
        ("column: theta_1", f"column: {quoted(COLUMNS['theta_1'])}"),
        ("column: w_1", f"column: {quoted(COLUMNS['w_1'])}"),
        ("v: 8.0", f"v: {{column: {quoted(COLUMNS['v'])}, unit: V}}"),
        ("k_T: nominal", "k_T: 0.12*lt"),
        (
            "map: {",
            "quantities:\n"
            f"  lt: {{prior: uniform, low: 0.5, high: 1.5, unit: '1', latex: {quoted(LATEX)}}}\n"
            "derived:\n"
            f"  amp: {{formula: {quoted(FORMULA)}, unit: N*m/rad, latex: {quoted(LATEX)}}}\n"
            f"  quot: {quoted('k_s/j_1 # ' + LEAVES)}\n"
            "map: {",
        ),
        ("figures: []", "corner: [k_e, lt, amp]"),
    )
    head, *rows = csv.reader((folder / "small.csv").read_text().splitlines())
    with (folder / FILE).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*(COLUMNS.get(name, name) for name in head), COLUMNS["v"]])
        writer.writerows([[*row, 8.0] for row in rows])
    return config
