"""The table of symbols against the paper and against its own geometry."""

import re
from pathlib import Path

import pint
import pytest
from support.case_tables import run_cases

from bayesdrill.basics import symbols
from bayesdrill.rig.models.motor_shaft import PARAMETERS


def test_nominal_tables_have_the_values_of_the_paper() -> None:
    """Values as printed: Table 1, and the initial guesses of Table 3."""
    first, third = symbols.NOMINAL["table_1"], symbols.NOMINAL["tables_2_3"]
    printed = {"j_m": 4e-4, "k_e": 0.06016, "k_T": 0.12, "r_m": 0.33, "l_m": 1.1e-3, "j_1": 0.0283}
    for table in (first, third):
        assert {name: table[name] for name in printed} == pytest.approx(printed)
        assert table["t_f"] == 0.1
        assert set(table) == set(PARAMETERS)
    assert (first["k_s"], first["c_m"]) == (0.30, pytest.approx(18.0e-5))
    assert (third["k_s"], third["c_m"]) == (0.26, pytest.approx(19.0e-5))
    assert symbols.DEFAULT_NOMINAL == "tables_2_3"


@run_cases("table", [symbols.PARAMETERS, symbols.STATES, symbols.INPUTS])
def test_every_symbol_is_complete(table: dict[str, symbols.Symbol]) -> None:
    registry = pint.UnitRegistry()
    for name, symbol in table.items():
        assert symbol.name == name
        assert symbol.latex
        assert symbol.meaning
        unit = registry.Quantity(1.0, symbol.unit)
        assert unit.to_base_units().magnitude == pytest.approx(1.0), name


def test_units_agree_with_the_equations() -> None:
    """Each term of the motor's two balances has the unit of its balance."""
    registry = pint.UnitRegistry()
    unit = {
        name: registry.Quantity(1.0, s.unit)
        for table in (symbols.PARAMETERS, symbols.STATES, symbols.INPUTS)
        for name, s in table.items()
    }
    unit["s"] = registry.Quantity(1.0, "s")
    balances = {
        "v": "l_m*i/s r_m*i r_s*i k_e*w_2 v_d",
        "t_f": "j_m*w_2/s c_m*w_2 k_T*i k_s*theta_1 j_1*w_1/s t_1 j_2*w_2/s c_s*w_1 c_1*w_1 "
        "t_cm t_sm t_c1 t_s1 k_s*theta_1/eta",
        "w_1": "w_sm w_s1",
    }
    for balance, terms in balances.items():
        for term in terms.split():
            quantity = eval(term, {}, unit).to(unit[balance].units)
            assert quantity.magnitude == pytest.approx(1.0), term


@run_cases("name", symbols.PARAMETERS)
def test_the_documents_have_a_row_for_every_parameter(name: str) -> None:
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
