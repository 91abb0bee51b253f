"""Leads (goal minus position) that hold an arm in a pose, free of friction, from slow swings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pliant.identify._excitation import Excitation
from pliant.identify._segments import all_segments
from pliant.identify.procedure import Procedure
from pliant.identify.servos import widen_swing

if TYPE_CHECKING:
    from pliant._core import Model, Servos
    from pliant._typing import Array
    from pliant.identify.procedure import Steps

#: Amplitude of the joints [rad]; period [s] and number of the swings.
AMPLITUDE, SWINGS = 0.05, (2.6, 2.75)
#: A joint's stiffness is reported if its change of lead exceeds this many standard deviations [1].
SIGNIFICANCE = 4.0
#: Iterations for the stiffness and the extra mass; each reduces the error about tenfold.
ITERATIONS = 8


@dataclass(frozen=True)
class Leads:
    """Leads near a pose, averaged over slow motion up and down so that friction cancels.

    Attributes:
        pose: Middle of the planned swings (n,) [rad].
        size: Amplitude of the goals (n,) [rad].
        lead: Lead that holds each joint (n,) [rad]; NaN if a joint did not swing.
        sigma: Standard deviations of `lead` (n,) [rad].
        gravity: Gravity torque of the model at the measured positions (n,) [N·m].
        row: Torque per mass at the tool, at the measured positions (n,) [N·m/kg].
    """

    pose: Array
    size: Array
    lead: Array
    sigma: Array
    gravity: Array
    row: Array


@dataclass(frozen=True)
class WeightTest:
    """Leads before and after a known mass was hung on the tool.

    Attributes:
        before, after: The leads.
        mass: The mass [kg].
    """

    before: Leads
    after: Leads
    mass: float

    @property
    def lead(self) -> Array:
        """Change of the lead (n,) [rad]."""
        return self.after.lead - self.before.lead

    @property
    def sigma(self) -> Array:
        """Standard deviations of `lead` (n,) [rad]."""
        return np.hypot(self.before.sigma, self.after.sigma)

    def torque(self, extra_mass: float = 0.0) -> Array:
        """Return the change of the torque that holds each joint (n,) [N·m].

        It includes that the arm sags under the mass. `extra_mass` [kg] is a mass at the tool that
        the model lacks.
        """
        before, after = self.before, self.after
        sag = after.gravity - before.gravity + (after.row - before.row) * extra_mass
        return after.row * self.mass + sag

    def solve(self) -> tuple[Array, Array, float]:
        """Return the stiffness k_p, its standard deviation (n,) [N·m/rad], and the extra mass [kg].

        The extra mass at the tool was there before, and the model lacks it. The table of the servos
        does not matter. Joints on which the mass has no clear effect have the stiffness NaN; if
        all have, the extra mass is NaN.
        """
        clear = np.abs(self.lead) > SIGNIFICANCE * self.sigma  # False for NaN
        lead = np.where(clear, self.lead, np.nan)
        extra = 0.0
        for _ in range(ITERATIONS):
            kp = self.torque(extra) / lead
            extra = self._mass(kp, kp * self.before.lead - self.before.gravity, self.before.row)
            if not np.isfinite(extra):
                break
        return kp, kp * self.sigma / np.abs(lead), extra

    def mass_seen(self, kp: Array) -> float:
        """Return the mass [kg] that the changes show if the stiffness is kp (n,) [N·m/rad]."""
        sag = self.torque() - self.after.row * self.mass
        return self._mass(kp, kp * self.lead - sag, self.after.row)

    def _mass(self, kp: Array, torque: Array, row: Array) -> float:
        """Return the mass [kg] at the tool that explains torques (n,) [N·m] best; NaN if none."""
        good = np.isfinite(torque)
        if not good.any():
            return float("nan")
        weight = 1.0 / (kp[good] * self.sigma[good]) ** 2
        row = row[good]
        return float((weight * row * torque[good]).sum() / (weight * row**2).sum())


def lead_procedure(
    model: Model, servos: Servos, *, period: float = 0.01, like: Leads | None = None
) -> Procedure[Leads]:
    """Return a procedure that measures leads in the present pose, or in that of `like`.

    The joints swing for 7 s, without `like` for 5 to 15 s more.
    """
    rig = Excitation(model, servos, period)
    return Procedure(lambda q: _measure(rig, q, like), model.n)


def _measure(rig: Excitation, q: Array, like: Leads | None) -> Steps[Leads]:
    if like is None:
        start = q
        size, q = yield from widen_swing(rig, q, AMPLITUDE)
        pose = rig.fit_within_limits(start, size)
    else:
        pose, size = like.pose, like.size
    rig.start_record()
    q = yield from rig.travel(q, q, pose)
    rig.records.clear()
    swing = rig.start_record()
    q = yield from rig.sweep(q, pose, size, *SWINGS)
    rig.start_record()
    yield from rig.travel(q, pose, pose)
    rig.records[:] = [swing]
    return _evaluate(rig, pose, size)


def _evaluate(rig: Excitation, pose: Array, size: Array) -> Leads:
    """Return the leads from the segments of steady motion, up and down."""
    means, sigma = np.full((3, rig.n), np.nan), np.full(rig.n, np.nan)
    segments = all_segments(rig)
    for i in range(rig.n):
        sides = [
            np.array(
                [
                    (s.drive, s.gravity, s.payload[0])
                    for s in segments
                    if s.joint == i and s.direction == direction
                ]
            )
            for direction in (1.0, -1.0)
        ]
        if min(map(len, sides)) < 2:
            continue
        means[:, i] = 0.5 * (sides[0].mean(axis=0) + sides[1].mean(axis=0))
        noise = sum(side[:, 0].var(ddof=1) / len(side) for side in sides)
        sigma[i] = 0.5 * np.sqrt(noise + rig.count[i] ** 2 / 12.0)
    lead, gravity, row = means
    return Leads(pose, size, lead, sigma, gravity, row)
