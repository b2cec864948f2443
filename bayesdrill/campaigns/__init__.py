"""Combine the runs of a campaign: their determined products, as a population.

`draws` holds what is known of each run, and `interim_prior` the density under which it was sampled.
`population` samples the population by reweighting these draws.  `time_study` looks for drift and
changes, and `outcomes` says what follows for runs, the table and the next run.
"""
