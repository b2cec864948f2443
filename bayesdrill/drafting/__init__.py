"""A first config of a record that nobody has described yet: what its names, sizes and relations
say.

`columns` reads heads, `timing` finds the clock, `sensors` and `roles` say what each column is,
`draft` writes the config. Each guess has its reason. Nothing here is used once a config is
there.
"""
