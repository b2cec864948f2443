"""Design the next experiment: the waveform of an input that determines named quantities best.

`source` describes the source, `limits` the limits of the rig, and `waveforms` the usual families.
`targets` defines quantities to learn, `visibility` finds targets that a waveform can determine, and
`knowledge` holds prior knowledge.  `responses` evaluates the information of a waveform,
`limited_motion` checks its limits, and `search` finds the best one.  `study` combines these
modules, and `variants` tries other channels and rates.  The package `report` turns the resulting
numbers into sentences.
"""
