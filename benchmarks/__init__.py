"""bayesdrill measured beside its peers: `python -m benchmarks.bench`."""
