"""Records of several modes whose masses a grid knows, and whether a run finds them."""
