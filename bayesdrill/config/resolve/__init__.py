"""Resolve entries of a config into objects: numbers, sensors, experiments, and the `Problem`.

Nothing here reads a file. Mistakes were reported by `schema` and `consistency`, or are raised with
their location.
"""
