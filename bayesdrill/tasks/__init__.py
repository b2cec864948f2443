"""Do the work of the commands, one module each, for `api` and `cli`; nothing here parses or prints."""
