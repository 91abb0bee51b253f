"""Speed comparison with other libraries: the problem, one module per kind of peer, the timing."""
