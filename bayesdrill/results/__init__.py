"""What stays on disk: the folder of a run, its chain, the ArviZ tree, where it comes from."""
