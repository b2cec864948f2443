"""Words and tools for every room: errors, symbols, units, formulas, random streams."""
