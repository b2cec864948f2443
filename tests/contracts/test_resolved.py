"""A config is resolved once: what makes a part of it is named in one function of the package."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import bayesdrill

PACKAGE = Path(bayesdrill.__file__).parent
RESOLVE = "bayesdrill.config.resolve"
MAKERS = {
    "case": ("build_model",),
    "quantities": ("nominal_table", "parse_parameter", "parse_quantity", "parse_formula"),
    "sensors": (
        *("noisy_channel", "sensor_entries", "parse_sensor_number"),
        *("build_sensing", "free_states", "latent_torque_number"),
    ),
    "experiments": ("split_experiments", "join_experiments"),
}


def named(text: str, module: str, maker: str, *, own: bool = False) -> Iterator[str]:
    """Functions that name `maker` of a module of `config.resolve`, however it was imported; `own`:
    the text is that module's.
    """
    tree = ast.parse(text)
    aliases, names = set[str](), {maker} if own else set[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == RESOLVE:
            aliases |= {one.asname or one.name for one in node.names if one.name == module}
        if isinstance(node, ast.ImportFrom) and node.module == f"{RESOLVE}.{module}":
            names |= {one.asname or one.name for one in node.names if one.name == maker}
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef):
            if maker in {a.arg for a in (*function.args.args, *function.args.kwonlyargs)}:
                continue  # a value of that name
            for node in ast.walk(function):
                of = node.value if isinstance(node, ast.Attribute) and node.attr == maker else None
                by_module = isinstance(of, ast.Name) and of.id in aliases
                if by_module or (isinstance(node, ast.Name) and node.id in names):
                    yield function.name


def test_the_names_are_found_however_they_are_imported() -> None:
    by_module = f"from {RESOLVE} import case as own\ndef a():\n    run(own.model)\n"
    by_name = f"from {RESOLVE}.case import model as make\ndef b():\n    make()\n    other.model()\n"
    assert [*named(by_module, "case", "model")] == ["a"]
    assert [*named(by_name, "case", "model")] == ["b"]
    assert [*named(by_name, "case", "nominal_table")] == []


def test_each_part_of_a_config_is_made_in_one_place() -> None:
    texts = {path: path.read_text() for path in sorted(PACKAGE.rglob("*.py"))}
    for module, makers in MAKERS.items():
        own = PACKAGE / "config" / "resolve" / f"{module}.py"
        for maker in makers:
            assert f"def {maker}(" in texts[own], f"{module} has no {maker}"
            places = {
                f"{path.relative_to(PACKAGE)}: {function}"
                for path, text in texts.items()
                if RESOLVE in text and maker in text
                for function in named(text, module, maker, own=path == own)
            }
            assert len(places) == 1, f"{module}.{maker} is named in {sorted(places)}"


def test_yaml_is_validated_where_it_is_loaded_and_nowhere_again() -> None:
    found = [
        path.relative_to(PACKAGE).as_posix()
        for path in sorted(PACKAGE.rglob("*.py"))
        if "model_validate" in path.read_text()
    ]
    assert found == ["config/loading.py"]
