"""The bench of the cap campaign: one arm, a hand that moves one axis, the force on the hand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

import pliant
from experiments.campaign_arms import AXES
from experiments.campaign_grip import OF_CAPACITY, Grip
from experiments.laws import UNBLURRED
from pliant.sim import Plant
from pliant.sim._mujoco import mujoco

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from experiments.campaign_arms import Arm
    from pliant.sim.friction import Friction

    Array = NDArray[np.float64]

#: Distance of the hand: the distance at which the cap is reached, times this, plus an offset [m,
#: rad].
WAY, MORE = 1.25, (0.005, 0.03)
#: Largest distance, beyond which the pose is another one [m, rad].
FARTHEST = (0.10, 0.40)
#: Start of the motion, its length, rest, and the evaluated part of the end [s].
START, RISE, REST, LOOK = 0.1, 0.7, 0.7, 0.15
#: Speed of a hand that keeps moving [m/s, rad/s].
MOVING = (0.05, 0.25)


@dataclass(frozen=True, kw_only=True)
class Disturbance:
    """One deviation from nominal conditions.

    Attributes:
        name: For tables.
        eta: Target adaptation of the soft axis.
        moving: True if the hand is evaluated in motion.
        short: Largest share of the report's `stop_distance` that the hand moves.
        delay: Ticks each way, known.
        count: Encoder count [rad], flickering by one, known.
        kp: True over assumed stiffness.
        identified: True if the controller knows the true stiffness.
        captured: True if gravity was captured in this pose.
        payload: Unknown mass at the tool [kg].
        gears: Friction by speed and load in place of the table's.
        gears_known: True if the controller knows it.
        plant: More options of the plant.
    """

    name: str
    eta: float = 0.0
    moving: bool = False
    short: float = np.inf
    delay: tuple[int, int] = (0, 0)
    count: float = 0.0
    kp: float = 1.0
    identified: bool = False
    captured: bool = False
    payload: float = 0.0
    gears: Friction | None = None
    gears_known: bool = False

    @property
    def wrong(self) -> bool:
        """True if the stiffness is wrong and the controller does not know it."""
        return self.kp != 1.0 and not self.identified


#: Share of the distance to an announced stop up to which the cap has to hold.
SHORT = 0.9

NOMINAL = Disturbance(name="nominal")
DISTURBANCES = (
    Disturbance(name="moving at 0.05 m/s", moving=True),
    Disturbance(name="short of stops", short=SHORT),
    Disturbance(name="η 0.9", eta=0.9),
    Disturbance(name="η 0.9, short of stops", eta=0.9, short=SHORT),
    *(
        Disturbance(name=f"k_p × {kp:g}, {word}", kp=kp, identified=known, captured=captured)
        for kp in (0.75, 1.25)
        for word, known, captured in (
            ("identified", True, False),
            ("not identified", False, False),
            ("not identified, gravity captured", False, True),
        )
    ),
    Disturbance(name="payload 0.3 kg", payload=0.3),
    Disturbance(name="payload 0.3 kg, gravity captured", payload=0.3, captured=True),
    Disturbance(name="encoder 0.088°, flicker", count=np.deg2rad(0.088)),
    Disturbance(name="a tick each way", delay=(1, 1)),
)


@dataclass(frozen=True, kw_only=True)
class Promise:
    """One cap in one pose, and its result.

    Attributes:
        pose: Index among the arm's poses.
        axis: Name.
        sign: Direction of the push.
        cap: F [N or N·m].
        guided: True if springs held the other axes.
        refused: True if the limits cannot hold the cap here; it was not run.
        announced: True if the report predicted before the push that the promise fails: within the
            band the tool moves farther than `stop_distance` of this axis and side, and the friction
            of the remaining joints there, `stop_friction`, exceeds the band.
        rubs: `stop_friction` of the report [N or N·m].
        promise: min(F, K_x h (1 - η)|e| / C_jj) at the deviation reached [N or N·m].
        felt: Force on the hand [N or N·m].
        friction: Σ_i |J⁺_ij| (τ_f,i + d_i |q̇_i|), which the assumed joints may hide [N or N·m].
        true_friction: The same with the true dry friction.
        band: Largest difference that keeps the promise [N or N·m].
        stop: Part of the push on mechanical stops, Σ_i J⁺_ij t_i [N or N·m]; 0 without contact.
        left: Σ_i |J⁺_ij| τ_f,i over the joints that no position limit held [N or N·m].
        locked: True if a joint's motion was held by its position limit.
        room: Distance of the nearest joint to its stop at the end [rad].
        drift: Largest distance of the stiff axes from the target over the run's end [m].
        speed: Rms speed of the joints at the end [rad/s].
    """

    pose: int
    axis: str
    sign: float
    cap: float
    guided: bool
    refused: bool
    announced: bool = False
    rubs: float = 0.0
    promise: float = np.nan
    felt: float = np.nan
    friction: float = np.nan
    true_friction: float = np.nan
    band: float = np.nan
    stop: float = 0.0
    left: float = np.nan
    locked: bool = False
    room: float = np.nan
    drift: float = np.nan
    speed: float = np.nan

    @property
    def error(self) -> float:
        """Felt minus promised, as a share of the cap."""
        return (self.felt - self.promise) / self.cap

    @property
    def kept(self) -> bool:
        """True if the promise was kept."""
        return abs(self.felt - self.promise) <= self.band

    @property
    def kept_as_said(self) -> bool:
        """True if it was kept with the friction that the report announced beyond the stop."""
        return abs(self.felt - self.promise) <= self.band + max(self.rubs - self.friction, 0.0)

    @property
    def stopped(self) -> bool:
        """True if it was provably missed because a joint was at its position limit.

        A stop takes part of the push, and the remaining joints have another friction: with both
        counted, the promise holds.
        """
        if self.kept or not (self.locked or self.stop != 0.0):
            return False
        band = self.band - self.friction + max(self.left, self.friction)
        return abs(self.felt - self.stop - self.promise) <= band


class Bench:
    """An arm under one disturbance; made once, used for all its promises."""

    def __init__(self, arm: Arm, disturbance: Disturbance = NOMINAL) -> None:
        """Build plant and hand."""
        self.arm, self.disturbance = arm, disturbance
        self.scale = arm.median_capacity[0] / OF_CAPACITY
        self.grip = Grip(self.scale)
        self.plant = Plant(
            arm.model,
            scene=[self.grip],
            delay=disturbance.delay,
            count=disturbance.count,
            flicker=1 if disturbance.count else 0,
            kp_scale=disturbance.kp,
            payload=(disturbance.payload, (0.0, 0.0, 0.0)) if disturbance.payload else None,
            friction=disturbance.gears or "coulomb",
        )
        known = disturbance.kp if disturbance.identified else 1.0
        count = disturbance.count
        self.servos = arm.servos.replace(kp=known * np.asarray(arm.servos.kp), encoder_step=count)
        if disturbance.gears is not None and disturbance.gears_known:
            self.servos = disturbance.gears.assumed(self.servos)
        self.compliance = 1.0 / np.asarray(self.servos.kp)
        gains = self.plant.gains
        self.damping = gains.damping + gains.kv
        self._controllers: dict[tuple[str, float], pliant.Controller] = {}
        self._captured: tuple[bytes, Array, Array] | None = None

    def promises(self, pose: int, q: Array) -> list[Promise]:
        """Measure all promises in one pose: axis, sign, cap, free and guided."""
        return [
            self.keep(pose, q, axis, sign, cap, guided=guided)
            for axis, row in zip(self.arm.axes, self.arm.rows, strict=True)
            for sign in (1.0, -1.0)
            for cap in self.arm.caps(row)
            for guided in (False, True)
        ]

    def keep(
        self, pose: int, q: Array, axis: str, sign: float, cap: float, *, guided: bool
    ) -> Promise:
        """Move one axis away from its target and compare the force with the promise."""
        row, seen = AXES.index(axis), self.disturbance
        named: dict[str, Any] = {
            "pose": pose,
            "axis": axis,
            "sign": sign,
            "cap": cap,
            "guided": guided,
        }
        if self.arm.capacity(q, row, sign, seen.payload) < cap:
            return Promise(**named, refused=True)
        controller = self._controller(axis, cap)
        if seen.captured:
            controller.capture_gravity(*self._capture(q))
        plant, grip, model = self.plant, self.grip, self.arm.model
        plant.reset(q)
        controller.reset(q)
        grip.hold(self.arm.rows if guided else [row])
        report = controller.report(q).axes[axis]
        stop = report.stop[int(sign > 0.0)]
        stop_distance = np.inf if stop is None else stop.distance
        way, speed = self._way(q, row, cap)
        if seen.short < np.inf:
            way = min(way, seen.short * stop_distance)
        # To keep the promise the tool has to move this far: the hand's own spring takes the rest.
        allowed, rubs = (0.40 if seen.wrong else 0.15) * cap, report.friction
        far = way - (cap + allowed + rubs) / grip.stiffness[row]
        announced = stop is not None and stop.distance < far and stop.friction > rubs + allowed
        target = model.forward_kinematics(q)
        last = START + way / speed
        end = last if seen.moving else last + REST
        felt, moved, speeds, drift, stiff = [], [], [], 0.0, [r for r in range(3) if r != row]
        stiff = [r for r in stiff if r in self.arm.rows]
        for tick in range(round(end * plant.rate)):
            now = tick / plant.rate
            grip.move(row, sign * speed if START <= now < last - 1e-9 else 0.0)
            command = controller.step(plant.read().q, target[:3, 3] if self._flat else target)
            plant.write(command.goal, command.torque_limit)
            plant.advance()
            if now >= end - LOOK:
                error = pliant.functional.pose_error(plant.tool, target)
                felt.append(sign * grip.force(row))
                moved.append(abs(error[row]))
                speeds.append(np.abs(plant.dq))
                drift = max(drift, float(np.linalg.norm(error[stiff])))
        jacobian = model.jacobian(plant.q)[self.arm.rows]
        column = np.linalg.pinv(jacobian)[:, self.arm.rows.index(row)]
        inverse = np.abs(column)
        c = float(jacobian[self.arm.rows.index(row)] ** 2 @ self.compliance)
        joint_speed = np.mean(speeds, axis=0)
        rubs = self.damping * joint_speed if seen.moving else 0.0 * joint_speed
        dry = self._dry(plant.q)
        friction = float(inverse @ (dry + rubs))
        moves = ~np.asarray(controller.diagnostics.locked)
        left = np.abs(np.linalg.pinv(jacobian[:, moves])[:, self.arm.rows.index(row)])
        space = np.minimum(plant.q - model.lower, np.asarray(model.upper) - plant.q)
        return Promise(
            **named,
            refused=False,
            announced=announced,
            rubs=stop.friction if stop is not None and announced else 0.0,
            promise=min(cap, (1.0 - seen.eta) * float(np.mean(moved)) / c),
            felt=float(np.mean(felt)),
            friction=friction,
            true_friction=float(inverse @ (plant.friction + rubs)),
            band=(0.40 if seen.wrong else 0.15) * cap + friction,
            stop=-sign * float(column @ self._stops()),
            left=float(left @ dry[moves]),
            locked=bool(np.any(controller.diagnostics.locked)),
            room=float(space.min()),
            drift=drift,
            speed=float(np.sqrt(np.mean(np.square(speeds)))),
        )

    def _dry(self, q: Array) -> Array:
        """Return the assumed dry friction (n,) [N·m] at rest under the arm's weight."""
        s, weight = self.servos, np.abs(self.arm.model.gravity(q))
        at_rest: Array = np.asarray(s.friction) + s.stribeck
        return at_rest + (np.asarray(s.load_friction) + s.load_stribeck) * weight

    @property
    def _flat(self) -> bool:
        """Return True if the task has no rotations."""
        return not any(row > 2 for row in self.arm.rows)

    def _way(self, q: Array, row: int, cap: float) -> tuple[float, float]:
        """Return distance and speed of the hand: until the axis gives the cap, and beyond."""
        kind = row // 3
        c = float(self.arm.model.jacobian(q)[row] ** 2 @ self.compliance)
        alone = WAY * cap * c / (1.0 - self.disturbance.eta) + MORE[kind]
        way = min(alone, FARTHEST[kind]) + cap / self.grip.stiffness[row]
        return way, MOVING[kind] if self.disturbance.moving else way / RISE

    def _settings(self, **more: Any) -> pliant.Settings:
        delay = sum(self.disturbance.delay) / self.plant.rate
        task = " ".join(self.arm.axes)
        return pliant.Settings(task=task, delay=delay, **UNBLURRED).replace(**more)

    def _controller(self, axis: str, cap: float) -> pliant.Controller:
        key = (axis, cap)
        if key not in self._controllers:
            soft = pliant.Axis(soft=cap, firm=cap, adaptation=self.disturbance.eta)
            settings = self._settings(axes={axis: soft})
            self._controllers[key] = pliant.Controller(self.arm.model, settings, self.servos)
        return self._controllers[key]

    def _capture(self, q: Array) -> tuple[Array, Array]:
        """Hold q for 2 s by an integrating goal; return the arm's positions and the goals."""
        if self._captured is None or self._captured[0] != q.tobytes():
            # Feed-forward and integration together oscillate: 9 of 20 poses with k_p 25 % too low.
            holding = self._settings(
                tracking=pliant.Tracking(integrate=4.0),
                compensation=pliant.Compensation(friction=0.0, damping=0.0),
            )
            controller = pliant.Controller(self.arm.model, holding, self.servos)
            self.plant.reset(q)
            controller.reset(q)
            self.grip.hold([])
            target = self.arm.model.forward_kinematics(q)
            goal = q
            for _ in range(round(2.0 * self.plant.rate)):
                command = controller.step(
                    self.plant.read().q, target[:3, 3] if self._flat else target
                )
                goal = command.goal
                self.plant.write(goal, command.torque_limit)
                self.plant.advance()
            self._captured = (q.tobytes(), np.array(self.plant.read().q), np.array(goal))
        return self._captured[1:]

    def _stops(self) -> Array:
        """Return the torques (n,) [N·m] of mechanical stops on the joints."""
        model, data, arm = self.plant.mj_model, self.plant.mj_data, self.arm.model
        out = np.zeros(arm.n)
        stops = data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
        q, names = self.plant.q, list(arm.joint_names)
        for joint, force in zip(data.efc_id[stops], data.efc_force[stops], strict=True):
            name = model.joint(joint).name
            if name in names:
                i = names.index(name)
                upper = arm.upper[i] - q[i] < q[i] - arm.lower[i]
                out[i] += -force if upper else force
        return out
