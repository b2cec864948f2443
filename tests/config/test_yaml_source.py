"""Configs are YAML 1.2."""

from pathlib import Path

from bayesdrill.config.yaml_source import parse


def test_yaml_is_version_1_2() -> None:
    """`1e-4` is a number, which PyYAML reads as text; an alias means the last anchor before it."""
    assert parse(Path("a.yaml"), "a: 1e-4\nb: 8e0\n").data == {"a": 1e-4, "b": 8.0}
    text = "a: &x 1\nb: *x\nc: &x 2\nd: *x\n"
    assert parse(Path("a.yaml"), text).data == {"a": 1, "b": 1, "c": 2, "d": 2}
