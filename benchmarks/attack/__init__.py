"""Malformed configs, records, results and command lines, at random (`make attack`)."""
