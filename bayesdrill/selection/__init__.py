"""Candidate models of a record: a job with one change of its config, or with several.

`changes` says what may be tried of a job, `config_edits` how the entries of a config say it, and
`candidates` puts changes together.
"""
