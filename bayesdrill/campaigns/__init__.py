"""Fit the many runs of a campaign, and combine their determined products as a population.

`runs` lists the runs, `records` checks all records, and `fits` fits each run and keeps its draws.
`study` runs these steps.  `watch` repeats them as files arrive, and `simulation` makes campaigns.
`conclusion` finds runs and products that need attention.  `charts` and `sections` show the results,
and `pages` writes the files.

`draws` holds the draws of each run, which are made under the prior of `interim_prior`.  `mixture`
turns these draws into the likelihood of the run, and `population` samples the population.
`time_study` looks for drifts and changes, and `outcomes` describes the runs, the nominal table and
the next run.  `fit` combines these modules.
"""
