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
LISTS = Path(__file__).with_name("sentence_words.txt").read_text(encoding="utf-8")
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
