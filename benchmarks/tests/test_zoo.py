"""The zoo's judge rejects what it must, and the parts that make its records are right."""

import math
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from support.case_tables import run_cases
from support.unexplained_records import causes_of, try_only

import bayesdrill as bd
from benchmarks.zoo import folder, judge, rows
from benchmarks.zoo.row import MORE_THAN_NOISE, Row
from benchmarks.zoo.runs import Importance, Run

SECONDS = 60.0
NAMES = ("k_s", "j_1")


@cache
def row(name: str = "samples_300") -> Row:
    return rows.chosen([name])[0]


def weights_of(mean: dict[str, float], error: dict[str, float]) -> Importance:
    return Importance(draws=10_000, share=0.8, mean=mean, error=error)


def run(
    *, shift: float = 0.0, weights: float | None = 0.0, effective: float = 1e4, **fields: object
) -> Run:
    """Means 1 and 2, sds 0.1 and 0.2; `shift` and `weights` move a mean, in its standard errors."""
    mean, sd = {"k_s": 1.0, "j_1": 2.0}, {"k_s": 0.1, "j_1": 0.2}
    error = {name: sd[name] / 100.0 for name in NAMES}
    moved = None if weights is None else mean | {"j_1": 2.0 + weights * error["j_1"]}
    usual: dict[str, object] = {
        "status": 0,
        "wall": 10.0,
        "converged": True,
        "seconds": {"map": 1.0, "sampling": 2.0, "report": 3.0},
        "steps": 1000,
        "tau": {"k_s": 2.0, "j_1": 3.0},
        "acceptance": (0.4, 0.5),
        "ess": effective,
        "fit": ({"channel": "w_1", "rms": 1.01},),
        "maxima": ({"values": mean, "log_posterior": 1.0, "weight": 1.0},),
        "importance": None if moved is None else weights_of(moved, error),
        "mean": mean | {"k_s": 1.0 + shift * error["k_s"]},
        "sd": sd,
        "draws": dict.fromkeys(NAMES, effective),
    }
    return Run(**(usual | fields))  # type: ignore[arg-type]


def unsound(**fields: object) -> Run:
    reasons = (f"the MAP leaves {MORE_THAN_NOISE}: w_1",)
    usual = {"status": 3, "converged": False, "reasons": reasons}
    return run(weights=None, **(usual | fields))


def complaints(of: Row, *pair: Run, shares: tuple[tuple[float, ...], ...] = ()) -> str:
    return "; ".join(judge.judged(of, pair, 300, SECONDS, shares).complaints)


@run_cases(
    "bad, complaint",
    [
        ({"shift": 5.0 * math.sqrt(2.0)}, "seeds disagree on k_s"),
        ({"shift": 7.0}, "seeds disagree on k_s"),
        ({"weights": 6.0}, "importance weights disagree on j_1"),
        ({"weights": None}, "no importance weights"),
        ({"draws": {"k_s": 0.0, "j_1": 1e4}}, "disagree"),
        ({"mean": {"k_s": math.nan, "j_1": 2.0}}, "disagree"),
        ({"sd": {"k_s": math.nan, "j_1": 0.2}}, "disagree"),
        ({"importance": weights_of({"k_s": 1.0}, {"k_s": 0.1})}, "disagree"),
        (
            {"importance": weights_of({"k_s": math.nan, "j_1": 2.0}, {"k_s": 1.0, "j_1": 1.0})},
            "disagree",
        ),
        ({"status": None}, "stopped"),
        ({"status": 2, "said": "first\nwrong config\n"}, "status 2: wrong config"),
        ({"status": 3, "reasons": ("tau grows",)}, "status 3: tau grows"),
        ({"converged": False}, "not converged"),
        ({"wall": 61.0}, "61 s"),
    ],
)
def test_a_sound_row_with_a_bad_run_fails(bad: dict[str, Any], complaint: str) -> None:
    """Whichever of the two runs it is."""
    assert complaint in complaints(row(), run(), run(**bad))
    assert complaint in complaints(row(), run(**bad), run())


def test_two_good_runs_pass() -> None:
    assert not complaints(row(), run(), run(shift=2.0, weights=-2.0))
    assert not complaints(row(), run(), run(shift=7.0, effective=100.0))  # few draws allow for more


def test_an_unsound_row_must_say_why() -> None:
    bad = row("wrong_gear")
    assert not complaints(bad, unsound(), unsound())
    for fields, complaint in (
        ({"status": 0}, "as if all were well"),
        ({"reasons": ("tau grows",)}, "no reason says"),
        ({"wall": 99.0}, "99 s"),
        ({"status": None}, "stopped"),
    ):
        assert complaint in complaints(bad, unsound(**fields), unsound())


def test_modes_must_have_their_shares() -> None:
    two = row("aliased_1")
    assert two.humps is not None
    exact, _ = two.humps.exact

    def message(*shares: float) -> str:
        return complaints(two, run(), run(), shares=tuple((x, 1.0 - x) for x in shares))

    assert not message(exact + 0.02, exact - 0.02)
    for wrong in (exact + 0.04, exact - 0.04, math.nan, 0.0):
        assert "shares of the humps" in message(exact, wrong)
    assert "shares of the humps" in complaints(two, run(), run())
    assert "shares of the humps" in complaints(two, run(), run(), shares=((), ()))


@pytest.mark.slow
def test_friction_with_friction_at_rest_is_named_where_a_bit_sticks_and_slips(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Friction alone ends at a poor maximum, and a rig without it hardly twists its shaft."""
    path, _ = folder.write(row("stick_slip"), tmp_path)
    parts = ("friction_rotor_1", "sticking_rotor_1", "sticking_motor", "prior_k_s", "free_start")
    try_only(parts, monkeypatch)
    causes = causes_of(bd.load(path))
    assert causes is not None
    assert causes.best is not None
    assert causes.best.parts == ("sticking_rotor_1",)
    assert causes.best.explains_all
    assert causes.best.lacks == ("t_c1",)
    sizes = {new.name: new.value for new in causes.best.new}
    assert sizes["t_s1"] / sizes["t_c1"] == pytest.approx(
        4.0, rel=0.05
    )  # which shows, not the scale
