"""The commands `pliant servos ...`: find, set up and examine servos, or emulate them."""
