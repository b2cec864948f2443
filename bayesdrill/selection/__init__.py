"""Build candidate models of a record: a job with one or several changes of its config.

`setting` collects what is known of the job.  From it, `measuring_changes`, `physics_changes`,
`absorbing_changes` and `scales` build changes, and `candidates` combines these.
"""
