"""Bands (bounds) that results on the simulated arm must satisfy, with a fixed random seed.

Each test names the preset in `experiments.controllers` that reaches its band. "Measured" in a
comment is the value at the time when the band was set. Tests marked `full` are the long forms of
tests that always run in part.
"""

import pytest

pytest.importorskip("mujoco", reason="the physics bands need the extra sim")
