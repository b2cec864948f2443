"""Build candidate models of a record: a job with one or several changes of its config.

`changes` lists changes to try, `candidates` combines them, and `config_edits` edits a config.
"""
