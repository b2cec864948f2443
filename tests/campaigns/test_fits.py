"""The fit of one run of a campaign, and the file of its draws."""

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from support import campaigns
from support.command_line import assert_refused, cli

from bayesdrill.analysis.identifiability.information import Information
from bayesdrill.basics.errors import Issue
from bayesdrill.basics.progress import SILENT, Silent
from bayesdrill.campaigns import fits, records
from bayesdrill.campaigns.draws import MAX_DRAWS, FittedRun, evenly_spaced
from bayesdrill.campaigns.fits import CheckedCampaign, Reference
from bayesdrill.campaigns.runs import CampaignPlan, read_plan
from bayesdrill.config.schema.config import IdentifySpec
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling.fit import FitPlan
from bayesdrill.sampling.proposal.learning import NoSupportError
from bayesdrill.tasks.remote import RefitExecutor

pytest.importorskip("pyarrow")

REFERENCE = Reference(
    names=("k_e", "j_1"),
    products=("k_e", "j_1/k_e"),
    exponents=((1, 0), (-1, 1)),
    values={"k_e": 0.06, "j_1": 0.0283},
)


@pytest.fixture
def plan(tmp_path: Path) -> CampaignPlan:
    return read_plan(campaigns.campaign(tmp_path))


def test_draws_are_read_as_they_were_written_and_not_for_another_record(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    logs, density = rng.normal(size=(5, 2)), rng.normal(size=5)
    fitted = FittedRun(log_products=logs, log_interim=density, reasons=("a", "b"), misfit=("b",))
    name = "../odd: name"
    fits.write_draws(tmp_path, name, "mark", REFERENCE, fitted)
    again = fits.read_draws(tmp_path, name, "mark")
    assert np.array_equal(again.log_products, logs)
    assert np.array_equal(again.log_interim, density)
    assert (again.reasons, again.misfit) == (("a", "b"), ("b",))
    assert fits.read_draws(tmp_path, name, "other") is None
    assert fits.read_draws(tmp_path, "run_1", "mark") is None


def test_a_run_that_cannot_be_sampled_has_a_reason_and_no_draws(
    plan: CampaignPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise NoSupportError("the priors exclude the record")

    monkeypatch.setattr(fits, "fit", refuse)
    run = plan.runs[0]
    job = records.run_job(plan, run)
    fitted = fits.fit_run(job.problem.posterior, fits.run_plan(plan, run, job), REFERENCE)
    assert fitted.reasons == ("the priors exclude the record",)
    fits.write_draws(tmp_path, run.name, "mark", REFERENCE, fitted)
    again = fits.read_draws(tmp_path, run.name, "mark")
    assert again.log_products.shape == (0, 2)


def test_runs_that_cannot_be_sampled_are_named_if_too_few_remain(
    plan: CampaignPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> FittedRun:
        none = np.zeros((0, 2))
        return FittedRun(log_products=none, log_interim=none[:, 0], reasons=("no support",))

    monkeypatch.setattr(fits, "fit_run", refuse)
    monkeypatch.setattr(fits, "find_reference", lambda *_: REFERENCE)
    result = cli("campaign", plan.source.path, "-o", tmp_path / "out", "--processes", "1")
    assert_refused(result, "0 runs are too few", "run_1: no support", "run_6: no support")


def test_a_failed_run_is_sampled_again_with_another_seed_until_it_has_been_tried_three_times(
    plan: CampaignPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mutant that it kills counts no attempts, so that a run is sampled for ever."""
    failing, seeds, said = {"run_1", "run_2"}, list[int](), list[str]()
    names = {fits.seed_of(plan, run, n): run.name for run in plan.runs for n in (1, 2, 3)}

    def fit_run(_: Posterior, fit: FitPlan, __: Reference) -> FittedRun:
        seeds.append(fit.chains.seed)
        name = names[fit.chains.seed]
        count = 0 if name == "run_1" else 3
        reasons = ("no support",) if name in failing else ()
        return FittedRun(
            log_products=np.zeros((count, 2)), log_interim=np.zeros(count), reasons=reasons
        )

    class Saying(Silent):
        def say(self, text: str) -> None:
            said.append(text)

    monkeypatch.setattr(fits, "fit_run", fit_run)
    digests, _ = records.check_runs(plan, SILENT)
    job = records.base_job(plan, digests)
    marks = fits.draws_marks(digests, REFERENCE)
    campaign = CheckedCampaign(plan=plan, job=job, reference=REFERENCE, marks=marks)

    def sample() -> int:
        before = len(seeds)
        with ThreadPoolExecutor(1) as pool:
            crew = RefitExecutor(pool)
            fits.fit_runs(campaign, tmp_path, crew, Saying())
        return len(seeds) - before

    assert sample() == 6
    assert sample() == 2
    assert said[0] == "run_1 is sampled again, attempt 2 of 3: no support"
    failing.discard("run_2")
    assert [sample(), sample()] == [2, 0]
    assert len({*seeds}) == len(seeds) == 10
    kept = {run.name: fitted for run, fitted in fits.kept_draws(campaign, tmp_path)}
    assert (kept["run_1"].attempt, kept["run_1"].usable) == (3, False)
    assert (kept["run_2"].attempt, kept["run_2"].reasons) == (3, ())


def test_a_product_that_only_the_prior_of_another_unknown_narrows_is_none_of_the_population() -> (
    None
):
    """Kills the mutant that takes `x`: the record knows `x^2 y`, and the prior of `y` does the rest."""
    record = Information(("x", "y"), np.array([[1000.0, 500.0], [0.0, 0.1]]))
    prior_sd = np.array([0.6, 0.2])
    by_prior = record.with_priors(prior_sd).bound(np.array([1.0, 0.0]))
    assert by_prior < 0.2 * prior_sd[0] < record.bound(np.array([1.0, 0.0]))
    shown = fits.shown_products(record, prior_sd, IdentifySpec())
    assert [product.exponents for product in shown] == [(2, 1)]


def test_a_product_that_few_runs_determine_is_left_out_with_its_prior(plan: CampaignPlan) -> None:
    rng, digests = np.random.default_rng(3), records.check_runs(plan, SILENT)[0]
    job = records.base_job(plan, digests)
    campaign = CheckedCampaign(plan=plan, job=job, reference=REFERENCE, marks={})
    narrow = np.log([0.06, 0.0283 / 0.06]) + 0.01 * rng.standard_normal((200, 2))
    draws = {
        run.name: FittedRun(
            log_products=narrow + [0.0, 2.0 * k] * rng.standard_normal((200, 2)),
            log_interim=np.full(200, 7.0),
            reasons=(),
        )
        for k, run in enumerate(plan.runs)
    }
    reduced, kept = fits.determined_products(campaign, draws)
    assert reduced.reference.products == ("k_e",)
    assert reduced.reference.left_out == {"j_1/k_e": "only 1 of 6 runs determine it"}
    logs = kept["run_1"].log_products
    expected = job.problem.posterior.space.priors["k_e"].logpdf(np.exp(logs[:, 0])) + logs[:, 0]
    assert np.allclose(kept["run_1"].log_interim, expected)
    same = dict.fromkeys(draws, draws["run_1"])
    assert fits.determined_products(campaign, same)[0] is campaign


def test_a_search_begins_at_the_reference_where_the_priors_allow_it(plan: CampaignPlan) -> None:
    posterior = records.run_job(plan, plan.runs[0]).problem.posterior
    start = fits.started_at(posterior, {"k_e": 0.065, "j_1": 5.0}).space.start
    assert start == {"k_e": 0.065, "j_1": posterior.space.start["j_1"]}


def test_a_new_run_is_compared_with_the_unknowns_of_those_before(plan: CampaignPlan) -> None:
    known, problems = records.KnownRecords(), list[Issue]()
    first = dataclasses.replace(plan, runs=plan.runs[:3])
    records.check_runs(first, SILENT, problems, known)
    held = dataclasses.replace(plan.runs[3], changes={"parameters": {"j_1": "nominal"}})
    digests, _ = records.check_runs(
        dataclasses.replace(plan, runs=(*plan.runs[:3], held)), SILENT, problems, known
    )
    assert [*digests] == ["run_1", "run_2", "run_3"]
    assert "has no unknown j_1" in problems[0].message


def test_many_draws_are_thinned_evenly() -> None:
    kept = evenly_spaced(2 * MAX_DRAWS)
    assert (len(kept), kept[0], kept[-1]) == (MAX_DRAWS, 0, 2 * MAX_DRAWS - 1)
    assert set(np.diff(kept)) <= {1, 2, 3}
