"""Move the walkers of one ensemble: emcee's moves, and the independence proposal over ridges.

A sampler gets a log density of batches, start points and a random stream, and no rig or file.
"""
