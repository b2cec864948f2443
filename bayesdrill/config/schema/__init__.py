"""Define the entries of a YAML config, as validated records with bounds, descriptions and defaults.

Only single entries are checked here. Conditions between entries are checked in `building`.
"""
