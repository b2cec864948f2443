"""Read, clean, decimate and simulate the files of a record.

`record.formats` reads each file format; the rules of a config about files are here.
"""
