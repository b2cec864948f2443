"""The sentences, the table and the entries of a verdict on Gaussian posteriors."""

import csv
import dataclasses

from support.linear_study import R_M, draws_of, verdict, words

from bayesdrill.basics.symbols import PARAMETERS
from bayesdrill.report.sections.nominal import verdict_csv, verdict_sentences
from bayesdrill.tasks.run_entries import verdict_data


def test_sentences_and_table_name_what_disagrees_and_what_is_not_determined() -> None:
    result = verdict(draws_of(2, r_m=1.2, k_s=1.2))
    first, second = verdict_sentences(result, "tables_2_3").splitlines()
    assert "determines 2 of the 2 independent products" in first
    assert "These disagree with tables_2_3: " in first
    assert "r_m (+" in first
    assert "Not determined by themselves: k_s, j_1" in second
    data = verdict_data(result, "tables_2_3")
    assert not data["agrees"]
    assert data["quantities"]["r_m"]["says"] == "disagrees"
    rows = csv.DictReader(verdict_csv(result, [*PARAMETERS.values()]).splitlines())
    units = {row["quantity"]: row["unit"] for row in rows}
    assert len(units) == 4
    assert (units["r_m"], units["k_s/j_1"]) == ("ohm", "(N*m/rad)*(kg*m**2)**-1")


def test_a_fit_that_is_not_noise_leaves_the_table_in_doubt() -> None:
    draws = draws_of(2, r_m=1.2)
    believed, doubtful = verdict(draws), verdict(draws, fits=False)
    assert words(believed)[R_M] == "disagrees"
    changed = {k: "in doubt" if x == "disagrees" else x for k, x in words(believed).items()}
    assert words(doubtful) == changed
    text = verdict_sentences(doubtful, "table")
    assert "These would, if the model were right, disagree with table: r_m (" in text
    assert "IN DOUBT: the verdict holds only if the model does" in text
    assert verdict_data(doubtful, "table")["agrees"] is None
    assert "IN DOUBT" not in verdict_sentences(believed, "table")
    assert verdict_data(believed, "table")["agrees"] is False


def test_a_table_agrees_only_with_a_fit_that_is_noise() -> None:
    draws = draws_of(3)
    assert "All 2 agree with table" in verdict_sentences(verdict(draws), "table")
    result = verdict(draws, fits=False)
    text = verdict_sentences(result, "table")
    assert "If the model were right, all 2 would agree with table" in text
    assert "IN DOUBT" in text
    for converged, why in ((True, "the model does not fit"), (False, "the run did not converge")):
        text = verdict_sentences(result, "table", converged=converged, believed=False)
        assert text == f"verdict: none, because {why}. The numbers may be wrong."
        data = verdict_data(result, "table", converged=converged, believed=False)
        assert (data["sentence"], data["agrees"]) == (text, None)


def test_values_that_agree_one_by_one_may_disagree_together() -> None:
    result = dataclasses.replace(verdict(draws_of(3)), joint=9.0)
    assert not result.agrees
    assert "does not describe this rig" in verdict_sentences(result, "table_1")
    doubtful = dataclasses.replace(result, fits=False)
    text = verdict_sentences(doubtful, "table_1")
    assert "Each by itself agrees with table_1. If the model were right, taken together" in text
    assert "does not describe this rig" not in text
