"""Make the `Problem` of a resolved case and its records.

Free initial states, lags and noise depend on both config and record, so they are built here.
"""
