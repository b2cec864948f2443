"""The table of symbols against the paper and against its own geometry."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pint
import pytest
from together import for_each

from bayesdrill.basics import symbols
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.motor_shaft import PARAMETERS


def test_the_two_nominal_tables() -> None:
    """Values as printed: Table 1, and the initial guesses of Table 3."""
    one, three = symbols.NOMINAL["table_1"], symbols.NOMINAL["tables_2_3"]
    printed = {"j_m": 4e-4, "k_e": 0.06016, "k_T": 0.12, "r_m": 0.33, "l_m": 1.1e-3, "j_1": 0.0283}
    for table in (one, three):
        assert {name: table[name] for name in printed} == pytest.approx(printed)
        assert table["t_f"] == 0.1
        assert set(table) == set(PARAMETERS)
    assert (one["k_s"], one["c_m"]) == (0.30, pytest.approx(18.0e-5))
    assert (three["k_s"], three["c_m"]) == (0.26, pytest.approx(19.0e-5))
    assert symbols.DEFAULT_NOMINAL == "tables_2_3"


def test_geometry_supports_the_default() -> None:
    stiffness = 79.3e9 * np.pi * 0.003**4 / (32 * 2.4)
    assert symbols.NOMINAL["tables_2_3"]["k_s"] == pytest.approx(stiffness, rel=0.02)
    inertia = 6.4 * (0.188 / 2) ** 2 / 2
    assert symbols.NOMINAL["tables_2_3"]["j_1"] == pytest.approx(inertia, rel=0.002)


def test_every_symbol_is_complete() -> None:
    def check(table: dict[str, symbols.Symbol]) -> None:
        registry = pint.UnitRegistry()
        for name, symbol in table.items():
            assert symbol.name == name
            assert symbol.latex
            assert symbol.meaning
            unit = registry.Quantity(1.0, symbol.unit)
            assert unit.to_base_units().magnitude == pytest.approx(1.0), name

    for_each(
        {str(table): (table,) for table in [symbols.PARAMETERS, symbols.STATES, symbols.INPUTS]},
        check,
    )


def test_units_agree_with_the_equations() -> None:
    """Each term of the motor's two balances has the unit of its balance."""
    registry = pint.UnitRegistry()
    unit = {
        name: registry.Quantity(1.0, s.unit)
        for table in (symbols.PARAMETERS, symbols.STATES, symbols.INPUTS)
        for name, s in table.items()
    }
    second = registry.Quantity(1.0, "s")
    volts = [
        unit["l_m"] * unit["i"] / second,
        unit["r_m"] * unit["i"],
        unit["r_s"] * unit["i"],
        unit["k_e"] * unit["w_2"],
        unit["v_d"],
    ]
    torques = [
        unit["j_m"] * unit["w_2"] / second,
        unit["c_m"] * unit["w_2"],
        unit["k_T"] * unit["i"],
        unit["k_s"] * unit["theta_1"],
        unit["j_1"] * unit["w_1"] / second,
        unit["t_f"],
        unit["t_1"],
        unit["j_2"] * unit["w_2"] / second,
        unit["c_s"] * unit["w_1"],
        unit["c_1"] * unit["w_1"],
        *(unit[name] for name in ("t_cm", "t_sm", "t_c1", "t_s1")),
        unit["k_s"] * unit["theta_1"] / unit["eta"],
    ]
    speeds = [unit["w_sm"], unit["w_s1"]]
    for terms, balance in ((volts, unit["v"]), (torques, unit["t_f"]), (speeds, unit["w_1"])):
        for term in terms:
            assert term.to(balance.units).magnitude == pytest.approx(1.0)


def test_models_speak_in_symbols() -> None:
    def check(name: str) -> None:
        model = MODELS[name]()
        assert model.name == name
        own = {symbol.name for symbol in model.declares}
        assert set(model.parameters) <= {*symbols.PARAMETERS} | own
        assert set(model.states) <= {*symbols.STATES} | own
        assert set(model.inputs) <= {*symbols.INPUTS} | own
        linear = model.linear(dict.fromkeys(model.parameters, 2.0))
        for row, column in linear.A:
            assert {row, column} <= set(model.states)
        for row, column in linear.B:
            assert row in model.states
            assert column in model.inputs
        assert set(linear.c) <= set(model.states)

    for_each({str(name): (name,) for name in MODELS}, check)


def test_the_documents_have_a_row_for_every_parameter() -> None:
    def check(name: str) -> None:
        page = "config.md" if name in PARAMETERS else "rigs.md"
        text = (Path(__file__).parents[2] / "docs" / page).read_text()
        (row,) = (line for line in text.splitlines() if line.startswith(f"| `{name}` |"))
        _, _, unit, *cells, _ = (cell.strip() for cell in row.split(" | ".strip()))
        symbol = symbols.PARAMETERS[name]
        assert unit == symbol.plain_unit
        if name in PARAMETERS:
            side, meaning, _ = cells
            assert side == ("shaft" if name in ("k_s", "j_1") else "motor")
        else:
            meaning, adds, hidden_by, typical = cells
            assert typical == symbol.typical
            assert adds
            assert {*re.findall(r"`(\w+)`", hidden_by)} & {*symbols.PARAMETERS} - {name}
        assert meaning == symbol.meaning

    for_each({str(name): (name,) for name in symbols.PARAMETERS}, check)
