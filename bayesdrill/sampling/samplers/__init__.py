"""How walkers move: one ensemble, its moves, and the independence proposal over ridges.

Samplers see a batch log density, start points and a random stream, and nothing else of the package.
"""
