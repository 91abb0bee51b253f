"""Stand-in for the package `lerobot.utils`."""
