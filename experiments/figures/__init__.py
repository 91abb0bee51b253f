"""Pictures of the experiments (extra `plot`); a function per picture, from outcomes to files."""
