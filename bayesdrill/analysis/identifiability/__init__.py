"""Study what a record can determine, before anything is sampled.

`structure` finds exact symmetries, `information` computes bounds, and `study` combines them.
"""
