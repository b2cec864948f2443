"""Words and figures of each section of a report.

One pair of modules each: `<section>_words` (sentences, tables, data) and `<section>_figure`.
"""
