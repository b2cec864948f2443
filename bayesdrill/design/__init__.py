"""Design the next experiment: the waveform of an input that determines named quantities best.

`source` describes the source, `limits` those of the rig, and `waveforms` the usual families.
`targets` defines what is to be learnt, `visibility` whether any waveform shows it, and `knowledge`
what is known before.  `responses` evaluates the information of a waveform, `limited_motion` whether
it keeps the limits, and `search` finds the best one.  `study` combines them, and `variants` tries
other channels and rates.
The result is a record of numbers, which the package `report` turns into sentences.
"""
