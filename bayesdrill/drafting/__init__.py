"""Draft a first config for a record without a description, from its headers and numbers.

`columns` reads headers, `signals` finds the clock, `sensors` and `roles` identify each column, and
`draft` writes the config. Each guess has its reason. Nothing here is used once a config exists.
"""
