"""Records of rigs that others built and measured, and whether a run finds what is known of them."""
