"""For notebooks and scripts: what the commands do, in memory, with results that show themselves."""
