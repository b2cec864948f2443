"""Learn the proposal of the ensembles from the log density, before the first step.

`learning` fits the proposal, `ridge_tracing` follows ridges, and `missed_mass` estimates the
posterior mass that the proposal misses. The moves of the walkers are in `samplers`.
"""
