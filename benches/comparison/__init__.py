"""Speed comparison of pliant with other libraries (peers) on one problem.

`problem` defines it, the modules `*_peer` and `*_peers` implement it, `timing` and `worker` time
the implementations, and `table` shows the results.
"""
