"""Real servos: tables, units, buses and the emulator that stands in for them."""
