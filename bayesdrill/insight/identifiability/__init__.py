"""What a record can say of the unknowns, before a single sample is drawn."""
