"""The density: unknowns, priors, noise, likelihood, posterior, and its slopes."""
