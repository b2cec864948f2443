"""The proposal of the ensembles, learnt from the log density before the first step.

`learning` fits it, `ridge_tracing` follows ridges, and `missed_mass` estimates what it leaves out.
The moves of the walkers are in `samplers`.
"""
