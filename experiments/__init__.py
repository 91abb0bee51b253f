"""The paper's experiments on the simulator (extra `sim`), and the demonstration made of them.

Scenarios (`hands`, `tracking`, `doors`, `resistance`, `promise`, ...) run one thing and return its
numbers; `chapters` put runs, statements and figures together; `demo.run` walks through the chapters
and leaves a report.
"""
