"""A campaign accepts sound draws of its runs, and names what is wrong with others."""

from __future__ import annotations

import numpy as np
import pytest

from bayesdrill.campaigns.draws import MAX_DRAWS, CampaignDraws, InterimDraws, evenly_spaced


def run(name: str, shape: tuple[int, int] = (10, 2), **changes: object) -> InterimDraws:
    fields = {"rig": "a", "time": None, "noted": {}}
    fields |= {"log_products": np.zeros(shape), "log_interim": np.zeros(shape[0])}
    return InterimDraws(name=name, **(fields | changes))  # type: ignore[arg-type]


def test_all_faults_of_all_runs_are_named_at_once() -> None:
    runs = (
        run("first"),
        run("first"),
        run("narrow", (10, 1)),
        run("odd", log_interim=np.full(10, np.nan)),
        run("late", time=np.inf),
    )
    with pytest.raises(ValueError, match="narrow") as raised:
        CampaignDraws(products=("k_s/j_1", "c_m/j_1"), runs=runs)
    assert all(word in str(raised.value) for word in ("first", "odd", "late", "(10, 1)"))
    with pytest.raises(ValueError, match="at least one run"):
        CampaignDraws(products=("k_s",), runs=())


def test_rigs_and_noted_columns_keep_their_order() -> None:
    runs = (
        run("1", rig="b", noted={"load": 1.0}),
        run("2", noted={"heat": 1.0}),
        run("3", rig="b"),
    )
    campaign = CampaignDraws(products=("k_s", "c_m"), runs=runs)
    assert campaign.rigs == ("b", "a")
    assert campaign.noted == ("load", "heat")


def test_many_draws_are_thinned_evenly() -> None:
    count = 2 * MAX_DRAWS
    kept = evenly_spaced(count)
    assert kept.shape == (MAX_DRAWS,)
    assert np.allclose(
        np.quantile(kept, [0.1, 0.5, 0.9]), np.array([0.1, 0.5, 0.9]) * count, rtol=0.01
    )
