"""Rates over hundreds of records with a known truth (`make rates`)."""
