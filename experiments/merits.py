"""Figures of merit of each experiment, under any conditions.

Forces in N and N·m, distances in mm, angles in deg or rad; each name has its unit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from experiments import doors, hands, host, laws, promise, tracking, walls
from experiments.conditions import NOMINAL, Conditions
from experiments.setups import AXES
from pliant.sim import LIGHT, STRONG, YAW

Figures = Mapping[str, float]
Measure = Callable[[Conditions], Figures]


def hold(conditions: Conditions) -> Figures:
    """Hold the grasp pose with every axis stiff."""
    law = laws.cap(soft="")
    return {"error [mm]": 1e3 * hands.idle(law, conditions=conditions).error}


def strong(law: hands.Law) -> Measure:
    """Move one soft axis with a strong hand."""

    def measure(conditions: Conditions) -> Figures:
        seen = hands.drag(law, STRONG, conditions=conditions)
        return {"force [N]": seen.force, "drift [mm]": 1e3 * seen.drift}

    return measure


def light(law: hands.Law) -> Measure:
    """Move the wrist with a 15 N hand."""

    def measure(conditions: Conditions) -> Figures:
        seen = hands.drag(law, LIGHT, conditions=conditions)
        return {"force [N]": seen.force, "drift [mm]": 1e3 * seen.drift}

    return measure


def capped(conditions: Conditions) -> Figures:
    """Move an axis with a cap of 15 N by a strong hand."""
    seen = hands.drag(laws.cap(eta=0.0), STRONG, conditions=conditions)
    left = 1e3 * seen.end
    return {"held [N]": abs(seen.held), "drift [mm]": 1e3 * seen.drift, "left after 4 s [mm]": left}


def kept(conditions: Conditions) -> Figures:
    """Measure all 200 poses where everything is known, a seeded tenth of them elsewhere."""
    poses = 200 if conditions == NOMINAL else 20
    runs = [
        promise.keep(case, guided=guided, conditions=conditions)
        for case in promise.cases(poses)
        for guided in (False, True)
    ]
    clear = [run.kept for run in runs if run.case.clear]
    return {
        "kept, all poses [%]": 100.0 * float(np.mean([run.kept for run in runs])),
        "kept, joints clear of stops [%]": 100.0 * float(np.mean(clear)),
    }


def yaw(conditions: Conditions) -> Figures:
    """Turn the tool by a hand."""
    seen = hands.drag(laws.cap(soft="yaw"), YAW, conditions=conditions)
    return {
        "torque [N·m]": seen.force,
        "position [mm]": 1e3 * seen.position,
        "leaves its place [rad]": seen.stays,
    }


def sinusoids(law: Callable[..., hands.Law]) -> Measure:
    """Swing every axis in turn, compliant meanwhile; return the worst."""

    def measure(conditions: Conditions) -> Figures:
        seen = [tracking.track(law(soft=a, eta=0.0), a, conditions=conditions) for a in AXES]
        return {
            "rms / amplitude": max(one.share for one in seen),
            "other positions [mm]": 1e3 * max(one.position for one in seen),
        }

    return measure


def door(scene: str, law: Callable[..., hands.Law] = laws.cap) -> Measure:
    """Open a rigidly gripped door."""

    def measure(conditions: Conditions) -> Figures:
        seen = doors.open_door(law, scene, "rigid", conditions=conditions)
        return {"angle [deg]": seen.angle, "force [N]": seen.force}

    return measure


def bumps(conditions: Conditions) -> Figures:
    """Run into walls; return the worst of all 18."""
    seen = [
        walls.bump(laws.cap, way, speed=speed, stiffness=k, conditions=conditions)
        for way in walls.DIRECTIONS
        for k in walls.STIFFNESSES
        for speed in walls.SPEEDS
    ]
    return {
        "peak beyond cap + v√(km) [N]": max(one.peak - one.allowed for one in seen),
        "after 0.3 s [N]": max(one.later for one in seen),
    }


def dead(conditions: Conditions) -> Figures:
    """Push after a host loss; return the worst of four directions."""
    pushes = ("+y", "-y", "-x", "-z")
    law = laws.cap(eta=0.0)
    return {"force [N]": max(host.die(law, p, conditions=conditions).force for p in pushes)}
