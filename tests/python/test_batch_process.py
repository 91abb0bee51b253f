"""Batch calls in a separate process: forks and memory use."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest


def run_code(code):
    """Run a program that must succeed; return its output."""
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_has_threads_of_its_own():
    code = """
import os, signal
import numpy as np, pliant
model = pliant.robots.arm7()
controller = pliant.Controller(model)
q = np.tile(0.5 * (model.lower + model.upper), (9000, 1))
targets = model.forward_kinematics(q[0])
want = controller.step_batch(q, targets).goal
if os.fork() == 0:
    signal.alarm(20)
    same = np.array_equal(controller.step_batch(q, targets).goal, want)
    model.gravity_batch(q)
    os._exit(0 if same else 1)
print(os.waitstatus_to_exitcode(os.wait()[1]))
"""
    assert run_code(code).split() == ["0"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no getrusage")
def test_many_arms_take_no_memory_beside_their_results():
    code = """
import resource, sys
import numpy as np, pliant
model = pliant.robots.arm7()
controller = pliant.Controller(model, pliant.Settings.paper())
q = np.tile(0.5 * (model.lower + model.upper), (400_000, 1))
target = model.forward_kinematics(q[0])
out = controller.step_batch(q[:10], target)
out = tuple(np.zeros(q.shape) for _ in range(3))
for array in out: array[:] = 1.0
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
controller.step_batch(q, target, out=out)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""
    assert float(run_code(code)) < 10.0  # [MB]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems bound memory otherwise")
def test_results_for_which_there_is_no_memory_are_a_memory_error():
    code = """
import resource
import numpy as np, pliant
model = pliant.robots.arm7()
controller = pliant.Controller(model)
q = np.tile(0.5 * (model.lower + model.upper), (100_000, 1))
target = model.forward_kinematics(q[0])
controller.step_batch(q[:10], target)
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 2_000_000, resource.RLIM_INFINITY))
for call in (model.kinematics_batch, model.jacobian_batch, model.gravity_batch,
             lambda q: controller.step_batch(q, target)):
    try:
        call(q)
    except MemoryError as error:
        print("Unable to allocate" in str(error))
"""
    assert run_code(code).split() == ["True"] * 4
