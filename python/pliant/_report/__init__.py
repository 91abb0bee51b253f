"""HTML pages, tables and figures of reports, for logs and for `experiments/`."""
