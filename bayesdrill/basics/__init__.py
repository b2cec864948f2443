"""Words and tools that every room may use: errors, symbols, units, formulas, random streams."""
