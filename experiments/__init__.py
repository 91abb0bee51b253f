"""The paper's experiments on the simulator, and the demonstration made of them.

This folder is not installed. Its modules run from the root of a clone (extra `experiments`), for
example `python -m experiments.descent`.

Scenarios (`hands`, `tracking`, `doors`, `resistance`, `promise`, ...) run one thing and return its
numbers; `chapters` put runs, statements and figures together; `demonstration.run` walks through the
chapters and leaves a report.
"""
