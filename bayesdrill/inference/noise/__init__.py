"""Noise models: how residuals are distributed."""
