"""Read, clean, decimate and simulate the files of a record.

`record.formats` reads each file format; this package applies the config's rules for files.
"""
