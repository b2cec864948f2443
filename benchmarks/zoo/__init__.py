"""The zoo: records of many kinds, on which the sampler has to prove itself."""
