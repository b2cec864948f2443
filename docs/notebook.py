"""From arrays to a corner plot, as in a notebook; `%%` begins a cell.

    python docs/notebook.py [folder]

It leaves a run in the folder, and a corner plot beside it.  The record is made here, so that nothing
else is wanted; put your own arrays in its place.
"""

# %% A record: times [s], what was measured, the supply
import sys
from pathlib import Path

import numpy as np

import bayesdrill as bd

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "notebook_run")
t = np.linspace(0.0, 10.0, 401)
rig = bd.MotorShaft(i_m=1 / 8)
truth = bd.nominal("tables_2_3")
w_2 = bd.respond(rig, truth, t, inputs={"v": 8.0}, signals=["w_2"])["w_2"]
w_2 += 0.1 * np.random.default_rng(2).standard_normal(len(t))

# %% A case: channels with unit and noise; a prior, a number or `nominal` for each parameter
box = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
case = bd.case(
    t,
    channels={"w_2": bd.Channel(w_2, "rad/s", sigma=0.1)},
    inputs={"v": 8.0},
    parameters=dict.fromkeys(truth, "nominal") | {"k_T": box, "k_s": box, "t_f": box},
    rig=rig,
    nominal="tables_2_3",
)
print(case.identify())

# %% The posterior, what it says, and how it looks
run = case.sample(case.find_map(), seed=1)
print(run.judge())
run.plot_corner().savefig(folder.with_suffix(".png"))

# %% To disk, and back; for ArviZ
run.save(folder, force=True)
tree = bd.open(folder).to_arviz()
print(tree["posterior"]["k_s"].mean().item())
