"""The commands `pliant log ...`: read, draw, convert, explain and verify logs."""
