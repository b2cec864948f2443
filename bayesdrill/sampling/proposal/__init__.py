"""Learn the proposal of the ensembles from the log density, before the first step.

`learning` fits it, `ridge_tracing` follows ridges, and `missed_mass` estimates what it leaves out.
The moves of the walkers are in `samplers`.
"""
