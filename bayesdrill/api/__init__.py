"""Provide the Python API for notebooks and scripts: all commands as functions and classes.

`arguments` checks the types of arguments, and the names in them. The package `tasks` does the
work. `print` shows a result.
"""
