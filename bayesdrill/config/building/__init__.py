"""Build objects of the entries of a config, one module for each section.

No file is read here. Contradictions are found while objects are built, and reported at their entries.
"""
