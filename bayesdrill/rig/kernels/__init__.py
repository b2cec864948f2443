"""All simulators are based on kernels, which compute 8 walkers (sets of parameters) side by side.

`linear` is for linear rigs, `time_stepping` for friction, `kalman_filter` for a latent torque.
A kernel serves many experiments: their samples, times and constants are arguments.
"""
