"""Design the next experiment: the waveform of an input that determines named quantities best.

`source` describes source and limits, and `waveforms` the usual families.  `targets` defines what is
to be learnt, `visibility` whether any waveform shows it, and `knowledge` what is known before.
`responses` evaluates the information of a waveform, and `search` maximises it.  `study` combines them
and returns a record of numbers, which the package `report` turns into sentences.
"""
