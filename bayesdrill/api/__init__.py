"""Here is the Python API for notebooks and scripts: all commands, with results that print.

Arguments are checked by their annotations and by name (`arguments`). The work itself is done in
`tasks`.
"""
