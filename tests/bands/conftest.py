"""Bands: bounds that results on the simulated arm must satisfy, with a fixed random seed.

Each test names the preset in `experiments.controllers` that reaches its band. Brackets hold the
value when the band was set. Marked `full`: the long form of a test that always runs in part.
"""

import pytest

pytest.importorskip("mujoco", reason="the physics bands need the extra sim")
