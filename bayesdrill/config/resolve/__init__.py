"""Resolve entries of a config into objects: numbers, sensors, experiments, and the `Problem`.

No file is read here. Contradictions are found while objects are built, and reported at their entries.
"""
