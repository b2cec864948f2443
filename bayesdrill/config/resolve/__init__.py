"""Entries of a config become objects: numbers, sensors, experiments, and the `Problem` they make
together.

Nothing here reads a file. Mistakes were told by `schema` and `consistency`, or are told with
their place.
"""
