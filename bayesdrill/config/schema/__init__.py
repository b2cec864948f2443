"""What may stand in a YAML config, as validated records with bounds, descriptions and defaults.

Only single entries are judged here. What must hold between them is in `resolve`.
"""
