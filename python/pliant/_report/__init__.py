"""Pages, tables and pictures that reports are made of, for logs and for `experiments/`."""
