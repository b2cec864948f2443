"""Malformed configs, records, results and command lines, at random, and kills (`make attack`)."""
