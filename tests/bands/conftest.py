"""Bands: bounds on results of the simulated arm, with a fixed random seed.

Each test names the settings of `experiments.controllers` that reach its band. "Measured" in a
comment is the value when the band was set. Tests marked `full` are longer forms of other tests.
"""

import pytest

pytest.importorskip("mujoco", reason="the physics bands need the extra sim")
