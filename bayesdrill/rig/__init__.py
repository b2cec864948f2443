"""What moves: models of rigs, the kernels compiled from them, and their exact response."""
