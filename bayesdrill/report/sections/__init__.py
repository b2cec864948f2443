"""One pair of modules for each section of a report: `<section>_words` (sentences, tables, data)
and `<section>_figure`.
"""
