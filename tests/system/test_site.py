"""The site: what stands in its pages is true of the program, and a broken one is found out."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML
from support import command_line
from support.document_blocks import DOCS, DOCUMENTS, ROOT, blocks

import bayesdrill as bd
from bayesdrill.cli import app
from bayesdrill.config import loading
from bayesdrill.config.schema.config import Config
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import dynamics
from docs import check_site, reference

YAML_SAFE = YAML(typ="safe", pure=True)


def completed(base: Mapping[str, Any], piece: Mapping[str, Any]) -> dict[str, Any]:
    """What a piece has in a section replaces what the base has there.

    Of another rig it has inputs and parameters of its own.
    """
    rig = piece.get("model", {}).get("name", "motor_shaft")
    if rig != "motor_shaft" and "parameters" in piece:
        channels = base["record"]["channels"]
        shown = {name: channels[name] for name in channels if name in MODELS[rig]().states}
        record = {**base["record"], "channels": shown}
        base = {"name": base["name"], "seed": base["seed"], "record": record}
    sections = {
        name: {**base[name], **one} if isinstance(base.get(name), Mapping) else one
        for name, one in piece.items()
    }
    return {**base, **sections}


def test_every_piece_of_a_config_is_one(tmp_path: Path) -> None:
    """Completed by the bundled config, where a page shows a part."""
    base = YAML_SAFE.load((ROOT / "configs" / "nominal_step.yaml").read_text())
    looked_at = 0
    for page in DOCUMENTS:
        for block in blocks(page, "yaml"):
            piece = YAML_SAFE.load(block)
            if piece is None or "toy_" in block:  # those are run with their package
                continue
            path = tmp_path / "piece.yaml"
            with path.open("w") as file:
                YAML_SAFE.dump(completed(base, piece), file)
            try:
                loading.load(path)
            except bd.InputError as error:
                pytest.fail(f"{page.name}\n{block}\n{error}")
            looked_at += 1
    assert looked_at > 10


def test_the_toys_are_the_package_that_is_shown() -> None:
    (shown,) = blocks(DOCS / "extending.md", "toml")
    said = set(re.findall(r'^toy_\w+ = "[\w:]+"$', shown, re.MULTILINE))
    brought = (ROOT / "tests" / "toys" / "toys-1.0.dist-info" / "entry_points.txt").read_text()
    lines = [line.split(" = ") for line in brought.splitlines() if " = " in line]
    assert said == {f'{name} = "{place}"' for name, place in lines}


def test_the_equations_for_matlab_are_those_of_the_model() -> None:
    """At values that no other product could imitate."""
    functions = [b for b in blocks(DOCS / "matlab.md", "matlab") if "function [" in b]
    linear_one, other = (next(b for b in functions if f" = {name}(" in b) for name in RIGS)
    values = {name: 1.1 + 0.3 * k for k, name in enumerate(bd.MotorShaft.parameters)}
    linear = bd.MotorShaft(i_m=1 / 8).linear(values)
    states = bd.MotorShaft.states
    a, constant = dynamics(linear, states, 1)[0], [linear.c.get(state, 0.0) for state in states]
    driven = np.array([linear.B.get((state, "v"), 0.0) for state in states])
    names = {**values, "i_m": 1 / 8}
    assert np.allclose(matrix(linear_one, "A", names), a)
    assert np.allclose(matrix(linear_one, "B", names), np.transpose([driven, constant]))
    x, v = np.arange(5.0) ** 2 + 0.7, 3.0
    names |= {"x": lambda k: x[k - 1], "u": lambda _: v, "twist": x[0] - x[1]}
    assert np.allclose(matrix(other, "dx", names)[:, 0], a @ x + driven * v + constant)


RIGS = ("rig", "rig_nl")


def matrix(function: str, name: str, values: Mapping[str, Any]) -> np.ndarray:
    """As MATLAB reads it; `^` is its power."""
    text = re.search(rf"^{name} = \[(.*?)\];", function, re.MULTILINE | re.DOTALL)[1]
    rows = [row.replace("^", "**").split(",") for row in text.split(";")]
    return np.array([[eval(cell.strip(), {}, dict(values)) for cell in row] for row in rows])


def test_the_reference_has_all_that_there_is() -> None:
    pages = {name: (DOCS / f"{name}.md").read_text() for name in ("commands", "entries", "api")}
    filled = {name: reference.fill(text) for name, text in pages.items()}
    commands = [command.name or command.callback.__name__ for command in app.registered_commands]
    assert {f"## {name}" for name in commands} <= {*filled["commands"].splitlines()}
    assert "`--profile`" in filled["commands"]
    assert all(f"`{name}`" in filled["entries"] for name in Config.model_fields)
    assert "| `walkers` | whole number" in filled["entries"]
    assert all(re.search(rf"\b(bayesdrill|bd)\.{name}\b", pages["api"]) for name in bd.__all__)


def test_every_page_is_in_the_site() -> None:
    index = (DOCS / "index.md").read_text()
    pages = {path.relative_to(DOCS).with_suffix("") for path in DOCUMENTS[1:]}
    for page in pages - {Path("index"), Path("paper.template")}:
        assert re.search(rf"^{page}$", index, re.MULTILINE), page


def test_pages_of_the_site_link_to_no_page_beside_it() -> None:
    """A file that is no page is offered as it is."""
    for page in (one for one in DOCUMENTS if DOCS in one.parents):
        for link in re.findall(r"\]\((?!\w+:|#)([^)#\s]+\.md)[)#]", page.read_text()):
            assert DOCS in (page.parent / link).resolve().parents, f"{page.name}: {link}"


def test_a_broken_site_is_found_out(tmp_path: Path) -> None:
    page = "<h1 id='here'>x</h1><a href='other.html#there'>y</a><a href='#here'>z</a>"
    (tmp_path / "index.html").write_text(page)
    (tmp_path / "other.html").write_text("<p id='there'></p><a href='https://example.org'>far</a>")
    assert list(check_site.wrong(tmp_path)) == []
    (tmp_path / "other.html").write_text(
        "<script src='https://example.org/x.js'></script><img src='gone.png'>"
        "<a href='nowhere.html'></a><p style='background: url(//example.org/y.png)'></p>"
    )
    (tmp_path / "site.css").write_text("@import url('https://example.org/font.css');")
    found = "\n".join(check_site.wrong(tmp_path))
    for said in (
        "index.html: other.html#there has no such anchor",
        "other.html: loads https://example.org/x.js",
        "other.html: gone.png is not there",
        "other.html: nowhere.html leads nowhere",
        "other.html: loads //example.org/y.png",
        "site.css: loads https://example.org/font.css",
    ):
        assert said in found


def test_pins_of_the_site_go_with_those_of_the_package() -> None:
    """Nothing is pinned twice: the one environment holds both lists."""
    locks = (ROOT / "requirements.lock", DOCS / "requirements.lock")
    own, more = ({line.split("==")[0].lower() for line in p.read_text().split()} for p in locks)
    assert not own & more
    assert {"sphinx", "myst-nb", "furo"} <= more


@pytest.mark.slow
def test_the_example_of_a_verdict_is_what_is_printed(tmp_path: Path) -> None:
    """The bundled run gives the same numbers everywhere, so its page can be held to the letter."""
    page = DOCS / "verdict.md"
    ran = command_line.cli(
        "posterior", ROOT / "configs" / "nominal_step.yaml", "--output", tmp_path / "out"
    )
    printed = [line.rstrip() for line in ran.text.splitlines()]
    for block in blocks(page, "text"):
        for line in block.splitlines():
            assert line in printed, line
    summary = (tmp_path / "out" / "summary.md").read_text().splitlines()
    shown = re.findall(r"^\| (c_m|k_e|k_s) \| (.*) \|$", page.read_text(), re.MULTILINE)
    assert len(shown) == 3
    for name, cells in shown:
        row = next(line for line in summary if line.startswith(f"| {name} "))
        assert {*cells.split(" | ")} <= {*row.strip("| ").split(" | ")}, name
