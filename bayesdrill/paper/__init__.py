"""Repeat the paper's studies by the public names of the package; nothing below knows of them.

`forward`, `searches`, `precision`, `printed` and `verification` compute; `study_tables`, `plots`
and `reproduction` show. Its printed matrix and its searches come in by entry points (`plugins`), as
those of other packages do.
"""
