"""Build objects from the entries of a config, one module for each section.

No file is read here. Contradictions are found while building, and reported at their entries.
"""
