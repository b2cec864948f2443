"""The proposal of the ensembles, learnt from the density before the first step."""
