"""Samplers: they see a batch log density, start points and a random stream, and nothing else."""
