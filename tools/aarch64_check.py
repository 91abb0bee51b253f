"""Compare the installed wheel with numbers of the golden file. Run by tools/aarch64.sh."""

from __future__ import annotations

import json
import platform
from pathlib import Path

import numpy as np

import pliant

GOLDEN = Path(__file__).resolve().parents[1] / "tests" / "data" / "golden"


def main() -> None:
    """Compare kinematics with the golden file, then run a few steps of every law."""
    model = pliant.Model.from_urdf(GOLDEN / "arm7.urdf", tip="tool")
    cases = json.loads((GOLDEN / "golden.json").read_text(encoding="utf-8"))
    for case in cases:
        pose, jacobian = model.kinematics(np.array(case["q"]))
        for value, key in ((pose[:3, 3], "p"), (pose[:3, :3], "R"), (jacobian, "J")):
            np.testing.assert_allclose(value, case[key], rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(model.gravity(case["q"]), case["gravity"], rtol=0.0, atol=1e-10)
    arm = pliant.robots.arm7()
    q = np.linspace(-0.4, 0.5, arm.n)
    target = arm.forward_kinematics(q + 0.05)
    for law in ("cap", "impedance", "paper"):
        settings = pliant.Settings.paper() if law == "paper" else pliant.Settings(law=law)
        controller = pliant.Controller(arm, settings)
        for i in range(100):
            command = controller.step(q + 1e-4 * i, target)
        assert np.isfinite(command.goal).all()
        assert (command.torque_limit > 0.0).all()
    print(f"pliant {pliant.__version__} on {platform.machine()}: {len(cases)} golden cases agree")


if __name__ == "__main__":
    main()
