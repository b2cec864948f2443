"""Make the `Problem` of a resolved case and its records.

What needs an entry and the record it speaks of is decided here: free starts, lags, and the noise.
"""
