"""For notebooks and scripts: what the commands do, in memory, with results that show themselves.

What is given is checked by annotations and by name (`arguments`). The work itself is in
`tasks`.
"""
