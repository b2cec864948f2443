"""Reports about records made by hand say the sentences that `sentences.yaml` lists for each record."""

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.case_tables import for_each, read_table

from bayesdrill.analysis.causes import Causes
from bayesdrill.analysis.run_analysis import TorqueSummary
from bayesdrill.basics.json_records import from_data
from bayesdrill.design.study import TargetOutlook
from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.report.sections import causes, convergence, design, torque
from bayesdrill.rig import MotorShaft
from bayesdrill.sampling.mode_search import Mode

type Data = dict[str, Any]
TABLE: dict[str, Data] = read_table("report/sections/sentences.yaml")


def of_causes(data: Data, _: Data) -> Iterator[str]:
    yield causes.describe_causes(from_data(Causes, data))


def of_mode(data: Data, _: Data) -> Iterator[str]:
    mode, units = from_data(Mode, data), DisplayUnits({})
    yield convergence.describe_map(mode, units)
    yield convergence.describe_searches(mode)
    yield convergence.maxima(mode, np.array([0.92, *[0.01] * 8]), units)


def of_torque(data: Data, given: Data) -> Iterator[str]:
    summary = from_data(TorqueSummary, data)
    rig: Any = SimpleNamespace(**{"frictions": (), "saturation": None} | given)
    yield torque.approximation_note(rig)
    yield torque.strayed(summary, rig)
    yield from (" ".join(line) for line in torque.torque_table(summary).lines)
    yield torque.law_sentences(summary, MotorShaft(1 / 8))


def of_design(data: Data, _: Data) -> Iterator[str]:
    made: Any = SimpleNamespace(**data)
    made.targets = [from_data(TargetOutlook, target) for target in data.get("targets", ())]
    yield design.target_sentences(made)
    yield design.odds_sentence(made)
    yield design.design_table(made)


SENTENCES: dict[str, Callable[[Data, Data], Iterator[str]]] = {
    "causes": of_causes,
    "mode": of_mode,
    "torque": of_torque,
    "design": of_design,
}


@pytest.mark.parametrize("section", TABLE)
def test_sentences_say_what_is_in_the_record(section: str) -> None:
    def check(case: Data) -> None:
        data = {**TABLE[section]["base"], **case.get("with", {})}
        text = " ".join(" ".join(SENTENCES[section](data, case.get("rig", {}))).split())
        assert [words for words in case.get("says", ()) if words not in text] == [], text
        assert [words for words in case.get("never", ()) if words in text] == [], text

    for_each({case["name"]: (case,) for case in TABLE[section]["cases"]}, check)
