"""Make the `Problem` of a resolved case and its records.

Free starts, lags and the noise need both the config and the record, so they are decided here.
"""
