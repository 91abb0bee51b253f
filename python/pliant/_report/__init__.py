"""Pages, tables and pictures of reports, for logs and for `experiments/`."""
