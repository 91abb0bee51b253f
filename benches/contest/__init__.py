"""Peers side by side: the problem, the peers, a process for each, and the turns they take."""
