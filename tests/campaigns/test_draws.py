"""Draws of a campaign: its rigs, noted columns, and how many draws are kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayesdrill.campaigns.draws import MAX_DRAWS, CampaignDraws, evenly_spaced
from bayesdrill.campaigns.runs import CampaignRun


def test_rigs_and_noted_columns_keep_their_order() -> None:
    first = CampaignRun(name="1", path=Path("1.csv"), rig="b", noted={"load": 1.0})
    second = CampaignRun(name="2", path=Path("2.csv"), rig="a", noted={"heat": 1.0})
    campaign = CampaignDraws(products=("k_s", "c_m"), runs=(first, second, first), fits=())
    assert campaign.rigs == ("b", "a")
    assert campaign.noted == ("load", "heat")


def test_many_draws_are_thinned_evenly() -> None:
    count = 2 * MAX_DRAWS
    kept = evenly_spaced(count)
    assert kept.shape == (MAX_DRAWS,)
    assert np.allclose(
        np.quantile(kept, [0.1, 0.5, 0.9]), np.array([0.1, 0.5, 0.9]) * count, rtol=0.01
    )
