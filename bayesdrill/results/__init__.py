"""What stays on disk: the folder of a run, its chain, the ArviZ tree, its origin."""
