"""Do the work of the commands for `api` and `cli`; no module here parses arguments or prints."""
