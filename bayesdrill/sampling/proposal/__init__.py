"""The proposal of the ensembles, learnt from the log density before the first step.

`learning` fits it, `ridge_tracing` follows ridges, `missed_mass` looks for what it leaves out.
How walkers then move is in `samplers`.
"""
