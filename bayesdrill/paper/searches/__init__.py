"""The ways in which the paper searches: kept to show where they end."""
