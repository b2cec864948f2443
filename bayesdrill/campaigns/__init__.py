"""Fit the many runs of a campaign, and combine their determined products as a population.

`runs` lists the runs, `records` checks all records, and `fits` fits each run and keeps its draws.
`study` does all of it.  `watch` repeats that as new files come, and `simulation` makes campaigns.
`conclusion` says what needs a look, `charts` and `sections` show it, and `pages` writes the files.

`draws` holds what is known of each run, and `interim_prior` the density under which it was sampled.
`population` samples the population by reweighting these draws.  `time_study` looks for drift and
changes, and `outcomes` says what follows for runs, the table and the next run; `fit` does all of it.
"""
