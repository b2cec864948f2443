"""Climbing and walking on the density: optimisers, the search for the MAP, the ensembles."""
