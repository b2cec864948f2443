"""Docstrings begin with a sentence: an imperative, or a finite verb beside those of its clauses."""

import ast
import re
from functools import cache
from pathlib import Path

from support.case_tables import run_cases
from support.syntax import nodes

PACKAGE = Path(__file__).parents[2] / "bayesdrill"
LONGEST_SENTENCE = 30  # words
# By room: the most fragments [%], and the most long sentences. Rooms beyond 3 % are not edited yet.
ROWS = """
campaigns 3 0, config 3 0, design 3 0, drafting 3 0, record 3 0, modules 3 0, analysis 3 0, api 3 0,
basics 3 0, inference 3 0, report 3 0, results 3 0, rig 3 0, sampling 3 0, selection 3 0, tasks 3 0
"""
LIMITS = {row.split()[0]: [int(limit) for limit in row.split()[1:]] for row in ROWS.split(",")}
# The lists know no grammar: a rare verb is added where it is missing, and a noun may slip through.
LISTS = """
accept add advance apply ask assign broadcast build calibrate call change check choose clean climb
combine compare compile compress compute continue convert copy correct count create cut decide define
describe design determine diagnose do draft draw drop end estimate evaluate export fill filter find fit
give group guess handle hold identify infer integrate join judge keep lay learn list load look make map
mark match measure merge minimise move multiply name note observe open pad parse pick place pose prepare
print profile project put raise rank read record redirect reduce refine refit refuse register regress
remove render repeat replace report reserve resolve return rewrite run sample save say score search see
select set show shut simulate solve split stack start step store strip study submit subtract sum tag take
tell test thin trace transform transpose treat try turn typeset unwrap update use validate verify wait
write yield approximate block declare derive edit expand interpret let maximise predict stop
summarise work
decorate escape examine exchange fork provide remake represent watch
/ allow allows are asks become becomes begin begins belong belongs can cannot collect collects come
comes contain contains could depend depends describe did differ differs does excludes follow follows
gives goes had has have hold holds includes is keeps knows lies limit makes may might must need passes
remain remains represents requires says should stand stands stay stays takes tells was were will would
applies advances computes consists designs explains helps multiplies needs refuses responds shows
/ a all any at by each how it its no on once one only over that the to what when which
/ as how if that what when where whether which who whose why
"""
IMPERATIVES, FINITE_VERBS, OBJECTS, CLAUSES = (set(words.split()) for words in LISTS.split("/"))
NOUNS_OR_VERBS = {f"{verb}s" for verb in IMPERATIVES}  # verbs where an object follows


def is_sentence(text: str) -> bool:
    start = re.split(r"[.;:!?]\s", re.sub(r"`[^`]*`", "a", text))[0]
    words = re.findall(r"[a-z]+", start.lower())
    open_clauses = 0
    for word, following in zip(words, [*words[1:], ""], strict=True):
        is_verb = word in FINITE_VERBS or (word in NOUNS_OR_VERBS and following in OBJECTS)
        if is_verb and open_clauses == 0:
            return True
        open_clauses += (word in CLAUSES) - is_verb
    return words[0] in IMPERATIVES and words[1:2] != ["of"]


@cache
def docstrings() -> dict[str, dict[str, str]]:
    texts = {room: dict[str, str]() for room in LIMITS}
    for path in sorted(PACKAGE.rglob("*.py")):
        place = path.relative_to(PACKAGE)
        for node in nodes(path):
            kinds = ast.Module | ast.ClassDef | ast.FunctionDef
            if isinstance(node, kinds) and (text := ast.get_docstring(node)):
                room = place.parts[0] if len(place.parts) > 1 else "modules"
                texts[room][f"{place}:{getattr(node, 'lineno', 1)}"] = text
    return texts


@run_cases("room", LIMITS)
def test_docstrings_have_short_sentences_and_begin_with_one(room: str) -> None:
    texts = docstrings()[room]
    fragments = [place for place, text in texts.items() if not is_sentence(text)]
    assert 100 * len(fragments) <= LIMITS[room][0] * len(texts), fragments
    whole = re.sub(r"\n {4}.*", "\n\n", "\n\n".join(texts.values()))  # without code
    sentences = re.split(r"[.!?:]\s+|\n\n|\n *[-*|>]", whole)
    long = [sentence for sentence in sentences if len(sentence.split()) > LONGEST_SENTENCE]
    assert len(long) <= LIMITS[room][1], long
