"""The sections of reports, a module each: its sentences, tables and figures, and its `PART` of a run."""
