"""Climbing and walking on the density: the MAP, the proposal, the ensembles."""
