"""Each module builds a section of reports: sentences, tables, figures, and `PART` for a run."""
