"""A first config of a record that nobody has described yet: what its names and sizes say.

`columns` reads heads, `signals` finds the clock, `sensors` and `roles` say what each column is,
`draft` writes the config. Each guess has its reason. Nothing here is used once a config is there.
"""
