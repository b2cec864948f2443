"""A first config of a record that nobody has described yet: what its names, sizes and relations say."""
