"""The files of a record: read, cleaned, thinned, and simulated anew.

What a file format is, is in `record.formats`; here are the rules of a config about them.
"""
