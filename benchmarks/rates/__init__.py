"""How often intervals hold the truth, over hundreds of records."""
