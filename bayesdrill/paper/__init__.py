"""The paper's studies repeated, by the public names of the floors alone; nothing below knows of
them.

`forward`, `searches`, `precision`, `printed` and `verification` compute; `study_tables`,
`plots` and `reproduction` show. Its printed matrix and its searches come in by entry points
(`plugins`), as those of other packages do.
"""
