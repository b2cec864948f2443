"""Move the walkers of one ensemble: emcee's moves, and the independence proposal over ridges.

A sampler gets a vectorised log density, start points and a random stream, but no rig or file.
"""
