"""Comparison with peers: the problem, the peers, a process for each, and their turns."""
