"""Repeat the studies of Sandoval, Cunha Jr and Sampaio (ENIEF 2013): `python -m studies.paper`.

`printed` has the numbers of the paper, `forward` its matrix and integrator, `optimisers` and
`searches` its searches, `precision` what a record can show. `run` does all of it, and
`study_tables`, `plots`, `schematics` and `reproduction` show what comes out.
"""
