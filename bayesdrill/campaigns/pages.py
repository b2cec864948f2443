"""Say what a campaign is and what it shows, on a screen and on a page."""

from __future__ import annotations

from bayesdrill.campaigns.records import CheckedRuns
from bayesdrill.campaigns.runs import CampaignPlan


def describe_plan(plan: CampaignPlan, checked: CheckedRuns) -> str:
    """Return what would run, and what is unusual about it, a line each."""
    spec, runs = plan.spec, plan.runs
    rigs = {run.rig for run in runs}
    many = f" of {len(rigs)} rigs" if len(rigs) > 1 else ""
    lines = [f"campaign {spec.name}: {len(runs)} runs{many}, each by {plan.base.path}"]
    times = [run.time for run in runs if run.time is not None]
    lines.append(
        f"times: over {max(times):.6g} s" if times else "times: none, so no drift is sought"
    )
    lines.append(f"noted: {', '.join(spec.noted) or 'nothing'}")
    return "\n".join([*lines, *(f"note: {note}" for note in checked.notes)])
