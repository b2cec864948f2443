"""Fit the many runs of a campaign, and find the population of their products of parameters.

`runs` lists the runs, `records` checks all records, and `fits` fits each run and keeps its draws.
`study` runs these steps.  `watch` repeats them as files arrive, and `simulation` makes campaigns.
`conclusion` finds alarms, `charts` and `sections` show the results, and `pages` writes the files.

`draws` holds each run's draws under the prior of `interim_prior`, and `mixture` turns these draws
into the likelihood of the run.  `population` samples the population.  `time_study` finds drifts
and changes, and `outcomes` describes runs, table and next run.  `fit` combines these modules.
"""
