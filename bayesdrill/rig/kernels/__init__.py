"""All simulators are based on compiled kernels, which compute eight walkers side by side.

`linear` is for linear rigs, `time_stepping` for friction, `kalman_filter` for a latent torque.
Kernels know no experiment: its shapes and constants are arguments.
"""
