"""Simulated experiments of the paper and of the package, and the demo that reports them.

This folder is not installed. Its modules run from the root of a clone (extra `experiments`), for
example `python -m experiments.descent`.

Scenarios (`disturbances`, `tracking`, `doors`, `cap_accuracy`, ...) simulate a task and return its
results. `chapters` combine runs, statements and figures. `demonstration.run` runs the chapters and
writes a report.
"""
