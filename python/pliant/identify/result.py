"""Results of identification: payload, servos and delay, with standard deviations and a summary."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import Controller, Payload
from pliant.identify._segments import bare_gravity, horizontal_axes, payload_rows

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pliant._core import Model, Servos, Settings
    from pliant._typing import Array, Mask
    from pliant.identify._excitation import Excitation
    from pliant.identify._regression import Delay, Solution


#: Largest standard deviation of the stiffness of a joint that counts as identified, as a share of
#: the stiffness [1].
KNOWN_SIGMA = 0.1
#: Ratio of residuals to assumed noise above which the model lacks an effect, e.g. a hand [1].
MAX_RESIDUAL_RATIO = 2.0
#: Standard deviations by which a force or a negative mass at the tool must differ from 0 to be
#: reported [1].
SIGNIFICANCE = 4.0
#: Horizontal force below which errors of the model can look like a force [N].
MIN_FORCE = 0.2
#: Smallest `PayloadEstimate.sigma_reduction` of a direction that the data determine [1].
MIN_REDUCTION = 0.5


@dataclass(frozen=True)
class PayloadEstimate:
    """An estimated payload with standard deviations.

    Attributes:
        mass: Mass [kg], at least 0.
        mass_sigma: Standard deviation of the mass [kg].
        com: Centre of mass (3,) in the tool frame [m]; 0 if no payload was found.
        com_sigma: Standard deviations of the centre (3,) [m]; ∞ if no payload was found.
        moments: Fitted mass, and mass times centre of mass (4,) [kg, kg·m].
        covariance: Covariance of `moments` (4, 4).
        sigma_reduction: Share by which the data reduce the standard deviation that was assumed
            before the fit, along four orthogonal directions of the scaled `moments` (4,), in
            descending order: 0: not at all; 1: to zero.
    """

    mass: float
    mass_sigma: float
    com: Array
    com_sigma: Array
    moments: Array
    covariance: Array
    sigma_reduction: Array

    @classmethod
    def of(cls, solution: Solution) -> PayloadEstimate:
        """Return the payload of a fit; `com_sigma` follows from the covariance to first order."""
        moments, covariance = solution.payload, solution.payload_covariance
        sigma = float(np.sqrt(covariance[0, 0]))
        mass = max(float(moments[0]), 0.0)
        com, com_sigma = np.zeros(3), np.full(3, np.inf)
        if mass > 2.0 * sigma:
            com = moments[1:] / mass
            slope = np.column_stack([-com, np.eye(3)]) / mass
            com_sigma = np.sqrt(np.diag(slope @ covariance @ slope.T))
        reduction = np.sort(solution.sigma_reduction)[::-1]
        return cls(mass, sigma, com, com_sigma, moments, covariance, reduction)

    @property
    def found(self) -> bool:
        """True if the mass differs from 0 by more than two standard deviations."""
        return self.mass > 2.0 * self.mass_sigma

    @property
    def payload(self) -> Payload:
        """Payload for `Controller.set_payload`, with mass 0 if no payload was found."""
        return Payload(self.mass if self.found else 0.0, self.com)

    def summary(self) -> list[str]:
        """Return sentences on mass and centre, and on directions that the data do not determine."""
        if not self.found:
            out = [f"no payload found: {self.mass:.3f} ± {2 * self.mass_sigma:.3f} kg (95 %)."]
        else:
            where = ", ".join(
                f"{axis} {1e3 * c:+.0f} ± {2e3 * s:.0f}"
                for axis, c, s in zip("xyz", self.com, self.com_sigma, strict=True)
            )
            out = [
                f"payload {self.mass:.3f} ± {2 * self.mass_sigma:.3f} kg, centre {where} mm in the "
                "tool frame (95 %)."
            ]
        lift = -float(self.moments[0])
        if lift > SIGNIFICANCE * self.mass_sigma:
            out.append(
                f"the tool is {lift:.3f} kg lighter than in the model: a hand or a cable lifts it, "
                "or a link of the model is too heavy."
            )
        undetermined = int((self.sigma_reduction < MIN_REDUCTION).sum())
        if undetermined:
            out.append(
                f"{undetermined} of the 4 numbers of the payload (mass and centre) cannot be told "
                "from these poses and stay near the assumed values: allow a larger span or give "
                "poses that turn the tool against gravity."
            )
        return out


@dataclass(frozen=True)
class Identification:
    """Identified servos, delay and payload, with standard deviations.

    Attributes:
        servos: Servo parameters for a `Controller`, with the identified `kp`, `friction`, `damping`
            and `kv`, and `load_friction` if it is significant. `stribeck` is not identified and is
            0.
        sigma: Standard deviations (n,) of `kp`, of `friction` at the load of the pose, and of
            `load_friction`, `damping` and `kv`, by name, in the units of `Servos`.
        load: Absolute gravity torque at the present pose (n,) [N·m].
        delay: Time from reading the positions to the arrival of the goal at the servos [s].
        delay_sigma: Standard deviation of the delay [s].
        payload: Estimated payload of the tool. A vertical force at the tool counts as its weight.
        tool_force: Constant horizontal force (3,) in base axes that acted on the tool meanwhile
            [N]. It is no part of the other values.
        tool_force_sigma: Standard deviation of its magnitude [N].
        residual_ratio: Root mean square of the residuals over the assumed noise of friction and
            encoder [1]. A value well above 1 means that the model misses an effect.
        undriven: Names of joints that could not be driven by their torque limits; their stiffness
            follows from gravity alone.
        joint_names: Names of the joints.
        assumed: Servo parameters assumed at the start.
    """

    servos: Servos
    sigma: dict[str, Array]
    load: Array
    delay: float
    delay_sigma: float
    payload: PayloadEstimate
    tool_force: Array
    tool_force_sigma: float
    residual_ratio: float
    undriven: tuple[str, ...]
    joint_names: tuple[str, ...]
    assumed: Servos

    @classmethod
    def of(
        cls, rig: Excitation, home: ArrayLike, solution: Solution, delay: Delay
    ) -> Identification:
        """Return the servo parameters, delay and payload of a fit at positions `home` (n,) [rad].

        `damping` excludes the back-EMF of PWM-limited servos, which `no_load_speed` covers. `kv` is
        the viscous resistance of a joint that follows its goal [N·m·s/rad], minus `damping`,
        back-EMF, and `kp` times the delay.
        """
        value, sigma = solution.value, solution.sigma
        damping = np.maximum(value["limit_damping"], 0.0)
        kv = np.maximum(value["goal_damping"] - damping - value["kp"] * delay.seconds, 0.0)
        weight = payload_rows(rig.model, home) @ solution.payload
        load = np.abs(bare_gravity(rig.model, home) + weight)
        share = value["load"] + value["motor"]
        share_sigma = np.hypot(sigma["load"], sigma["motor"])
        share = np.where(share > 1e-6, share, 0.0)
        speed = rig.servos.no_load_speed
        if speed is not None:
            # If the measured damping is below the assumed back-EMF, raise the no-load speed.
            min_speed = rig.torque / np.maximum(damping, 1e-6 * rig.torque)
            speed = np.where(damping < rig.back_emf, min_speed, np.asarray(speed))
        servos = rig.servos.replace(
            no_load_speed=speed,
            kp=np.maximum(value["kp"], 0.05 * rig.kp),
            friction=np.maximum(value["friction"], 0.0),
            load_friction=share,
            stribeck=0.0,
            load_stribeck=0.0,
            damping=np.maximum(damping - rig.back_emf, 0.0),
            kv=kv,
        )
        servo_sigma = {
            # A fit below the smallest accepted stiffness is wrong by at least the difference.
            "kp": np.maximum(sigma["kp"], servos.kp - value["kp"]),
            "friction": np.hypot(sigma["friction"], share_sigma * load),
            "load_friction": share_sigma,
            "damping": sigma["limit_damping"],
            "kv": np.sqrt(
                sigma["goal_damping"] ** 2
                + sigma["limit_damping"] ** 2
                + (value["kp"] * delay.sigma) ** 2
            ),
        }
        return cls(
            servos=servos.replace(stiffness_known=bool(_is_known(servos, servo_sigma).all())),
            sigma=servo_sigma,
            load=load,
            delay=delay.seconds,
            delay_sigma=delay.sigma,
            payload=PayloadEstimate.of(solution),
            tool_force=horizontal_axes(rig.model) @ solution.force,
            tool_force_sigma=float(np.sqrt(np.linalg.eigvalsh(solution.force_covariance)[-1])),
            residual_ratio=solution.residual_ratio,
            undriven=tuple(rig.model.joint_names[i] for i in sorted(set(rig.undriven))),
            joint_names=tuple(rig.model.joint_names),
            assumed=rig.servos,
        )

    @property
    def stiffness_known(self) -> Mask:
        """Mask (n,) of the joints whose stiffness is identified: standard deviation below 10 %."""
        return _is_known(self.servos, self.sigma)

    @property
    def friction(self) -> Array:
        """Dry friction of each joint at the gravity load of the present pose (n,) [N·m]."""
        servos = self.servos
        return np.asarray(servos.friction) + np.asarray(servos.load_friction) * self.load

    def controller(self, model: Model, settings: Settings | None = None) -> Controller:
        """Return a controller with the identified servos, payload and delay."""
        controller = Controller(model, settings, self.servos)
        if self.payload.found:
            controller.set_payload(self.payload.mass, self.payload.com)
        controller.set_delay(self.delay)
        return controller

    def summary(self) -> list[str]:
        """Return one sentence per joint, then sentences on delay, payload and warnings."""
        out = []
        servos, old = self.servos, self.assumed
        n = len(self.joint_names)
        assumed_values = [np.broadcast_to(np.asarray(x), n) for x in (old.kp, old.friction)]
        for i, name in enumerate(self.joint_names):
            kp, friction = float(servos.kp[i]), float(self.friction[i])
            text = (
                f"{name}: k_p {kp:.3g} ± {2 * self.sigma['kp'][i]:.2g} N·m/rad "
                f"({kp / assumed_values[0][i]:.2f} × assumed), "
                f"friction {friction:.3g} ± {2 * self.sigma['friction'][i]:.2g} N·m "
                f"(assumed {assumed_values[1][i]:.3g}), damping {servos.damping[i]:.3g} outside "
                f"the torque limit and {servos.kv[i]:.2g} N·m·s/rad within it"
            )
            if servos.load_friction[i]:
                share = 100.0 * servos.load_friction[i]
                text += f"; the friction includes {share:.0f} % of the load torque"
            out.append(text + ".")
        out.append(
            f"loop delay {1e3 * self.delay:.1f} ± {2e3 * self.delay_sigma:.1f} ms, from reading to "
            "arrival of the goal."
        )
        out += self.payload.summary()
        force = float(np.linalg.norm(self.tool_force))
        if force > max(SIGNIFICANCE * self.tool_force_sigma, MIN_FORCE):
            where = ", ".join(
                f"{axis} {f:+.1f}" for axis, f in zip("xyz", self.tool_force, strict=True)
            )
            out.append(
                f"a horizontal force of {force:.1f} ± {2 * self.tool_force_sigma:.1f} N acted on "
                f"the tool ({where} N in base axes) and is left out of these values: a hand or "
                "a cable."
            )
        for name in np.asarray(self.joint_names)[~self.stiffness_known]:
            out.append(
                f"{name}: k_p is not known within 10 %; its load hardly changes "
                "between these poses."
            )
        out += [
            f"{name} could not be driven by its torque limit; its k_p rests on gravity alone."
            for name in self.undriven
        ]
        if self.residual_ratio > MAX_RESIDUAL_RATIO:
            out.append(
                f"residuals are {self.residual_ratio:.1f} × what friction and encoder explain: "
                "play, a wrong mass in the model, or a hand on the arm."
            )
        return out

    def __str__(self) -> str:
        return "\n".join(self.summary())


def _is_known(servos: Servos, sigma: dict[str, Array]) -> Mask:
    return sigma["kp"] < KNOWN_SIGMA * np.asarray(servos.kp)
