"""Compiled kernels, eight walkers side by side: what every simulator computes in the end.

`linear` is for linear rigs, `time_stepping` for friction, `kalman_filter` for a latent torque. Nothing
here knows an experiment: shapes and constants come as arguments.
"""
