"""Each finding of an analysis has a sentence, with the names and numbers that it brings."""

import string

from support.case_tables import run_cases
from support.command_line import ROOT

from bayesdrill.analysis.findings import Finding
from bayesdrill.basics.json_records import as_data, from_data
from bayesdrill.report.findings import SENTENCES, finding_sentences

SOURCES = "".join(path.read_text() for path in ROOT.glob("bayesdrill/analysis/*.py"))


@run_cases("kind", SENTENCES)
def test_each_sentence_is_that_of_a_finding_which_brings_what_stands_in_it(kind: str) -> None:
    assert f'"{kind}"' in SOURCES
    places = {place for _, place, _, _ in string.Formatter().parse(SENTENCES[kind]) if place}
    assert {place for place in places if f'"{place}"' not in SOURCES} <= {"draws", "mostly"}


def test_a_finding_says_the_same_after_it_was_written() -> None:
    names = {"name": "j_1"}
    numbers = {"value": 0.25, "low": 0.5, "high": float("inf"), "percent": 0.0002}
    finding = Finding("unlikely nominal value", names, numbers)
    assert from_data(Finding, as_data(finding)) == finding
    (sentence,) = finding_sentences([finding])
    assert sentence.startswith("the nominal value 0.25 of j_1 is far outside its prior")
    assert "from 0.5 to inf with all but 0.0002 %" in sentence
