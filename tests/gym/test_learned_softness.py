"""The experiment that learns to open doors: its features, its costs, a very short search."""

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium")
pytest.importorskip("cmaes")

from experiments import learned_softness as learned


def test_the_turn_is_measured_about_z_from_any_orientation():
    rng = np.random.default_rng(2)
    start, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    start *= np.sign(np.linalg.det(start))
    for angle in (-1.0, 0.0, 0.7):
        c, s = np.cos(angle), np.sin(angle)
        now = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ start

        def seen(rotation):
            tool = np.concatenate([np.zeros(3), rotation[:, 0], rotation[:, 1]])
            return {"tool": tool[None], "force": np.array([[10.0, -50.0, 0, 0, 0, 0]])}

        values = learned.features(seen(now), seen(start))
        np.testing.assert_allclose(values, [[1.0, angle, 0.5, -1.0]], atol=1e-12)


@pytest.mark.slow
def test_a_policy_without_gains_is_its_constant_action():
    gains = np.zeros((2, 5, learned.FEATURES))
    gains[:, :, 0] = learned.START
    policy = learned.Trial(2).costs(gains, [3, 4])
    constant = learned.Trial(2).costs(gains[:, :, :1], [3, 4])
    for one, other in zip(policy, constant, strict=True):
        np.testing.assert_array_equal(one, other)
    cost, force, is_open = policy
    assert is_open.all()
    np.testing.assert_array_equal(cost, force)
    assert cost[0] != cost[1]


@pytest.mark.slow
def test_a_search_measures_its_mean_and_draws(monkeypatch, tmp_path):
    for name, value in {
        "DOORS": 1, "CANDIDATES": 4, "GENERATIONS": 2, "MEASURE_EVERY": 2, "STEPS": 10,
        "VALIDATION": [7, 8], "TEST": [9, 10, 11],
    }.items():  # fmt: skip
        monkeypatch.setattr(learned, name, value)
    first, second, last = learned.search("policy", 1)
    assert [first["episodes"], second["episodes"]] == [0, 8]
    assert first["parameters"] != second["parameters"]
    assert first["cost"] >= first["force"] > 0.0
    best = min((first, second), key=lambda one: one["cost"])
    assert last["parameters"] == best["parameters"]
    assert last["episodes"] == best["episodes"]
    assert last["cost"] != best["cost"], "the test doors are other doors"
    learned.draw([first, second, last], tmp_path / "curve.png")
    assert (tmp_path / "curve.png").stat().st_size > 1000
