"""Candidate models of a record: configs that differ from one in a thing each, or in several.

`parts` says what may be tried of a job, `config_edits` how the entries of a config say it, and
`candidates` puts parts together.
"""
