"""bayesdrill: what a record says about the nine parameters of a torsional drilling rig."""

__version__ = "0.1.0"
