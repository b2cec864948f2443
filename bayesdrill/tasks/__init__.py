"""What the commands do, one module each: posterior, map, identify, calibrate, compare, ladder,
verify.

`api` and `cli` call these. Nothing here parses an argument or prints.
"""
