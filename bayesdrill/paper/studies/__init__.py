"""The studies of the paper, computed anew: its numbers, its integrator, its searches, its causes."""
