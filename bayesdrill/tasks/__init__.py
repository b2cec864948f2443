"""What the commands do, one module each, for `api` and `cli`; nothing here parses or prints."""
