"""Design the next experiment: the waveform of an input that determines named quantities best.

`source` describes the device that drives the input, `limits` the limits of the rig, and `waveforms`
the usual families.  `targets` defines quantities to learn, `visibility` finds the targets that a
waveform can determine, and `knowledge` holds prior knowledge.  `responses` evaluates the information
of a waveform, `limited_motion` checks the limits, and `search` finds the best waveform.  `promise`
predicts standard deviations, and `variants` those with other channels and rates.  `study` combines
these modules, and `rivals` designs an experiment that distinguishes two models.
"""
