"""Each finding of an analysis has a sentence, with the names and numbers that it brings."""

import string

from support.case_tables import run_cases
from support.command_line import ROOT

from bayesdrill.report.findings import SENTENCES

PACKAGE = ROOT / "bayesdrill"
ROOMS = ("analysis", "inference", "sampling", "report")
SOURCES = "".join(
    path.read_text()
    for room in ROOMS
    for path in (PACKAGE / room).rglob("*.py")
    if path != PACKAGE / "report" / "findings.py"
)
# Places that code fills with a phrase, made of the numbers of a finding.
PHRASES = {"draws", "late", "often", "mostly", "counted", "places", "reason", "seen", "cure"}


@run_cases("kind", SENTENCES)
def test_each_sentence_is_that_of_a_finding_which_brings_what_stands_in_it(kind: str) -> None:
    assert f'"{kind}"' in SOURCES
    places = {place for _, place, _, _ in string.Formatter().parse(SENTENCES[kind]) if place}
    assert {place for place in places if f'"{place}"' not in SOURCES} <= PHRASES
