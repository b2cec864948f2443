"""Studies made with bayesdrill by its public names; the package knows nothing of them."""
