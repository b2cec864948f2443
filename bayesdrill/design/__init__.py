"""Design the next experiment: the waveform of an input that determines named quantities best.

`source` describes the device that drives an input, `limits` the limits of the rig, and `waveforms`
the usual families.  `targets` defines quantities to learn, `visibility` finds targets that some
waveform can determine, and `knowledge` holds prior knowledge.  `responses` evaluates waveforms,
`limited_motion` checks limits, and `search` finds the best waveform.  `promise` predicts standard
deviations, and `variants` predicts them for other channels and rates.  `study` combines these
modules, and `rivals` designs an experiment that distinguishes two models.
"""
