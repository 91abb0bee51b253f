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

    @property
    def sag(self) -> Array:
        """Change of the model's gravity torque, because the arm yields to the mass (n,) [N·m]."""
        return self.after.gravity - self.before.gravity

    @property
    def torque(self) -> Array:
        """Change of the torque that holds each joint (n,) [N·m]."""
        return self.after.row * self.mass + self.sag

    @property
    def stiffness(self) -> tuple[Array, Array]:
        """Stiffness k_p and its standard deviation (n,) [N·m/rad]; NaN for joints without load."""
        clear = np.abs(self.lead) > SIGNIFICANCE * self.sigma  # False for NaN
        kp = np.where(clear, self.torque / np.where(clear, self.lead, 1.0), np.nan)
        return kp, kp * self.sigma / np.where(clear, np.abs(self.lead), np.nan)

    def mass_seen(self, kp: Array) -> float:
        """Return the mass [kg] that the changes show if the stiffness is kp (n,) [N·m/rad]."""
        return self._mass(kp, kp * self.lead - self.sag)

    @property
    def extra_mass(self) -> float:
        """Mass at the tool [kg] that the arm carried before and the model lacks, NaN if unknown.

        The stiffness is `stiffness`, so that the table of the servos does not matter.
        """
        kp, _ = self.stiffness
        return self._mass(kp, kp * self.before.lead - self.before.gravity)

    def _mass(self, kp: Array, torque: Array) -> float:
        """Return the mass [kg] at the tool that explains joint torques best."""
        good = np.isfinite(torque) & np.isfinite(kp)
        if not good.any():
            return float("nan")
        weight = 1.0 / (kp[good] * self.sigma[good]) ** 2
        row = self.after.row[good]
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
