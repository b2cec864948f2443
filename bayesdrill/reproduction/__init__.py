"""The paper's own way, beside which the package's can be put: its integrator."""
