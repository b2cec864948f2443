"""Each finding of an analysis has a sentence, with the names and numbers that it brings."""

import string

from support.case_tables import run_cases
from support.command_line import ROOT

from bayesdrill.basics.findings import Finding
from bayesdrill.basics.json_records import as_data, from_data
from bayesdrill.report.findings import SENTENCES, finding_sentence, finding_sentences

PACKAGE = ROOT / "bayesdrill"
ROOMS = ("analysis", "inference", "sampling", "report")
SOURCES = "".join(
    path.read_text()
    for room in ROOMS
    for path in (PACKAGE / room).rglob("*.py")
    if path != PACKAGE / "report" / "findings.py"
)
PHRASES = {"draws", "mostly", "counted", "places", "reason"}  # which the numbers of a finding make


@run_cases("kind", SENTENCES)
def test_each_sentence_is_that_of_a_finding_which_brings_what_stands_in_it(kind: str) -> None:
    assert f'"{kind}"' in SOURCES
    places = {place for _, place, _, _ in string.Formatter().parse(SENTENCES[kind]) if place}
    assert {place for place in places if f'"{place}"' not in SOURCES} <= PHRASES


def test_a_finding_says_the_same_after_it_was_written() -> None:
    names = {"name": "j_1"}
    numbers = {"value": 0.25, "low": 0.5, "high": float("inf"), "percent": 0.0002}
    finding = Finding("unlikely nominal value", names, numbers)
    assert from_data(Finding, as_data(finding)) == finding
    walkers = {"walkers": 8, "stay": 5, "steps": 9, "walker": 1, "ensemble": 0}
    place = {"mean": 1.0, "centre": 2.0, "sd": 0.5}
    stuck = Finding("stuck walkers", {"unknown": "k_s"}, walkers | place, {"ensembles": (1, 0)})
    assert from_data(Finding, as_data(stuck)) == stuck
    said = "1 of 8 walkers (1 in ensemble 0) is stuck: the longest did not move for 5 of 9 steps"
    assert finding_sentence(from_data(Finding, as_data(stuck))).startswith(said)
    (sentence,) = finding_sentences([finding])
    assert sentence.startswith("the nominal value 0.25 of j_1 is far outside its prior")
    assert "from 0.5 to inf with all but 0.0002 %" in sentence
