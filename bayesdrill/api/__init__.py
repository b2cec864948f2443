"""Provide the Python API for notebooks and scripts: all commands, with printable results.

Arguments are checked by their annotations and by name (`arguments`). The work itself is done in
`tasks`.
"""
