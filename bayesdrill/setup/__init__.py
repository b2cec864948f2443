"""A config becomes objects, or every mistake of it at once."""
