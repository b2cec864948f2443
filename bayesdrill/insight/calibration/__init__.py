"""Simulation-based calibration: many simulated records refitted, and where the truth ranks."""
