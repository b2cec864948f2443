"""Resolve entries of a config into objects: numbers, sensors, experiments, and the `Problem`.

Nothing here reads a file. What contradicts itself is found as it is built, and filed at its entry.
"""
