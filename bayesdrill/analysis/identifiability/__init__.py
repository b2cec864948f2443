"""What a record can say of the unknowns, before a single sample is drawn.

`structure` finds exact symmetries, `information` the bounds, `study` puts them together. What
draws say afterwards is in `analysis.verdict`.
"""
