"""What the commands do, one module each.

These are posterior, map, identify, calibrate, compare, ladder and verify.  `api` and `cli` call
them.  Nothing here parses an argument or prints.
"""
