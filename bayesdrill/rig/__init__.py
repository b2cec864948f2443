"""What moves: models of rigs, kernels compiled from them, the exact response."""
