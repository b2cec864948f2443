"""Build objects from the entries of a config, one module for each section.

No file is read here. Contradictions are found while objects are built, and are reported at their
entries.
"""
