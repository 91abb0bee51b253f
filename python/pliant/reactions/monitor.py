"""`ReactionMonitor`: evaluates reactions once per control cycle; at most one is in force."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pliant import functional
from pliant._core import ConfigError, ContactEstimator, Controller, WrenchEstimate
from pliant._validation import format_value, instance, number
from pliant.reactions.actions import Action, Running, Stop, step_toward
from pliant.reactions.conditions import Condition, Evaluator, TickContext, condition

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pliant._typing import Array


@dataclass(frozen=True)
class Reaction:
    """A condition and the actions that it triggers.

    Attributes:
        when: Condition that begins the actions when it becomes true.
        then: One action or several, in the order in which they change the target.
        until: Condition that ends the actions. None: they end together: if one is `Stop` or
            `Retract`, by `ReactionMonitor.resume()`; else if one is `Follow`, when it is complete;
            else once `when` has been false for the time `clear`.
        clear: Time [s] for which `when` must be false, see `until`.
    """

    when: Condition
    then: Action | Sequence[Action]
    until: Condition | None = None
    clear: float = 0.5

    def __post_init__(self) -> None:
        """Check the types of conditions and actions, and the value of `clear`."""
        condition(self.when, "Reaction.when")
        if self.until is not None:
            condition(self.until, "Reaction.until")
        has_valid_type = isinstance(self.then, Action | Sequence)
        if not (
            has_valid_type
            and self.actions
            and all(isinstance(action, Action) for action in self.actions)
        ):
            raise ConfigError(
                "Reaction.then must be an action, as Hold() or Retract(0.05), or several in a "
                f"list, got {format_value(self.then)}"
            )
        if self.until is not None and any(isinstance(action, Stop) for action in self.actions):
            raise ConfigError("a Stop ends by ReactionMonitor.resume() alone; use Hold with until")
        number(self.clear, "Reaction.clear", 0.0, unit="s")

    @property
    def actions(self) -> tuple[Action, ...]:
        """The actions `then` as a tuple, also if it is a single action."""
        return (self.then,) if isinstance(self.then, Action) else tuple(self.then)

    @property
    def is_one_shot(self) -> bool:
        """True if all actions are complete as soon as they have begun."""
        return all(action.is_one_shot for action in self.actions)

    @property
    def needs_force(self) -> bool:
        """True if a condition or an action needs an estimate of the contact force."""
        ends = self.until is not None and self.until.needs_force
        return self.when.needs_force or ends or any(action.needs_force for action in self.actions)


@dataclass(frozen=True)
class ReactionEvent:
    """An entry in the log of a `ReactionMonitor`: a reaction began or ended.

    Attributes:
        time: Time since the first update of the monitor [s].
        what: `began`, `ended`, or `called` for a reaction whose actions complete immediately.
        reaction: The reaction.
        wrench: Estimated wrench on the tool at that time; None: there was no contact estimator.
    """

    time: float
    what: Literal["began", "ended", "called"]
    reaction: Reaction
    wrench: WrenchEstimate | None


class _InForce:
    """State of the reaction in force: its running actions, and the time to its end."""

    def __init__(self, index: int, reaction: Reaction, tick: TickContext) -> None:
        self.index, self.reaction = index, reaction
        self._running: list[Running] = []
        self._is_latching = any(action.is_latching for action in reaction.actions)
        self._until = None if reaction.until is None else reaction.until.evaluator()
        self._time_clear = 0.0
        try:
            for action in reaction.actions:
                self._running.append(action.begin(tick))
        except BaseException:
            self.end(tick)
            raise

    def target(self, tick: TickContext) -> Array:
        """Return the target pose (4, 4): the caller's target, changed by each action in turn."""
        pose = tick.target
        for running in self._running:
            pose = running.target(tick, pose)
        return pose

    def over(self, tick: TickContext, holds: bool) -> bool:
        """Return True if the reaction ends in this tick; `holds`: its condition `when` is true."""
        if self._until is not None:
            return self._until(tick)
        if self._is_latching:
            return False
        are_over = [over for running in self._running if (over := running.over(tick)) is not None]
        if are_over:
            return all(are_over)
        self._time_clear = 0.0 if holds else self._time_clear + tick.dt
        return self._time_clear > self.reaction.clear

    def end(self, tick: TickContext) -> None:
        """End all running actions, the last one first."""
        for running in reversed(self._running):
            running.end(tick)


class ReactionMonitor:
    """Applies reactions to a controller; call `update` once per tick, before the controller's step.

    A reaction begins when its condition becomes true, and again only after the condition has been
    false. A reaction in force ends when a reaction earlier in the list begins. After the end of a
    reaction, the target moves back to the caller's target at `resume_speed`, without a jump.

    Args:
        controller: Controller whose settings the reactions may change, or its wrapper
            `Loop.controller`.
        reactions: Reactions, the most important first.
        contact: Contact estimator. None: one with default arguments is created if a reaction needs
            a force.
        resume_speed: Speed at which the target moves back, (linear [m/s], angular [rad/s]).

    Attributes:
        log: The last 1000 events (`ReactionEvent`).

    Raises:
        OutOfRangeError: The threshold of a force is below the uncertainty of its estimate.
        TypeError: `controller`, `contact` or an item of `reactions` has the wrong type.
        ConfigError: Axes or joints do not exist, or settings are inconsistent.
    """

    def __init__(
        self,
        controller: Controller,
        reactions: Sequence[Reaction],
        *,
        contact: ContactEstimator | None = None,
        resume_speed: tuple[float, float] = (0.1, 0.5),
    ) -> None:
        inner = instance(getattr(controller, "inner", controller), Controller, "controller")
        self.controller = controller
        if contact is not None:
            instance(contact, ContactEstimator, "contact")
        if not isinstance(reactions, Iterable):
            raise TypeError(f"reactions must be a list of Reaction, got {format_value(reactions)}")
        self.reactions = tuple(instance(reaction, Reaction, "a reaction") for reaction in reactions)
        if contact is None and any(reaction.needs_force for reaction in self.reactions):
            contact = ContactEstimator(inner)
        if contact is not None and contact.controller is not inner:
            raise ConfigError("contact belongs to another controller: create it with this one")
        if not (min(resume_speed) > 0.0 and np.isfinite(resume_speed).all()):
            raise ConfigError(f"resume_speed is two numbers > 0, got {resume_speed!r}")
        self.contact, self._resume_speed = contact, resume_speed
        for reaction in self.reactions:
            reaction.when.validate(contact, controller)
            if reaction.until is not None:
                reaction.until.validate(contact, controller)
            for action in reaction.actions:
                action.validate(controller)
        self.log: deque[ReactionEvent] = deque(maxlen=1000)
        self._in_force: _InForce | None = None
        self.reset()

    def reset(self) -> None:
        """Return to the state before the first tick: no reaction in force, no events in the log.

        A tare of the contact estimator is kept. Call this method together with the controller's
        `reset`. Settings that a `Yield` has changed are not restored; to restore them, call
        `resume` and `update` before `reset`.
        """
        self._evaluators: list[Evaluator] = [
            reaction.when.evaluator() for reaction in self.reactions
        ]
        self._is_armed = [True] * len(self.reactions)
        self._in_force, self._resuming, self._ending = None, False, False
        self._last_target: Array | None = None
        self._time = -1.0
        self.log.clear()
        if self.contact is not None:
            self.contact.reset()

    @property
    def active(self) -> Reaction | None:
        """The reaction in force; None if no reaction is in force."""
        return None if self._in_force is None else self._in_force.reaction

    @property
    def stopped(self) -> bool:
        """True if a reaction with the action `Stop` is in force."""
        active = self.active
        return active is not None and any(isinstance(action, Stop) for action in active.actions)

    @property
    def resuming(self) -> bool:
        """True while the target moves back to the caller's target after a reaction."""
        return self._resuming

    @property
    def wrench(self) -> WrenchEstimate | None:
        """Estimated wrench on the tool at the last tick; None: there is no contact estimator."""
        return None if self.contact is None else self.contact.estimate

    def resume(self) -> None:
        """End the reaction in force at the next call of `update`."""
        self._ending = self._in_force is not None

    def update(
        self,
        q: ArrayLike,
        target: Any,
        *,
        dt: float | None = None,
        load: ArrayLike | None = None,
        current: ArrayLike | None = None,
        sent: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> Any:
        """Evaluate the reactions in one tick, and return the target for the controller's step.

        Args:
            q: Measured joint positions (n,) [rad].
            target: Target pose of the caller, in a form that `Controller.step` accepts.
            dt: Time since the last tick [s]; None: 1 / rate of the settings.
            load: Torques reported by the servos (n,) [N·m]; see `ContactEstimator.update`.
            current: Currents reported by the servos (n,) [A]; see `ContactEstimator.update`.
            sent: Goals and torque limits that were sent; see `ContactEstimator.update`.

        Returns:
            The target pose (4, 4) for the step, or `target` itself if no reaction changes it.

        Raises:
            ShapeError, OutOfRangeError, ConfigError: An input is invalid; nothing has changed.
            Exception: The function of a `Call` raised this exception.
        """
        tick = self._collect(q, target, dt, load, current, sent)
        holds = [evaluator(tick) for evaluator in self._evaluators]
        self._finish(tick, holds)
        self._start(tick, holds)
        if self._in_force is not None:
            self._last_target = self._in_force.target(tick)
            return self._last_target
        if self._resuming and self._last_target is not None:
            distance, angle = (speed * tick.dt for speed in self._resume_speed)
            self._last_target = step_toward(self._last_target, tick.target, distance, angle)
            self._resuming = self._last_target is not tick.target
            return self._last_target if self._resuming else target
        return target

    def _collect(self, q: Any, target: Any, dt: float | None, *measured: Any) -> TickContext:
        """Update the contact estimate, and return the data of this tick for all conditions.

        `measured` holds the arguments `load`, `current` and `sent` of `update`.
        """
        controller = self.controller
        pose = functional.as_pose(target).matrix
        tool = controller.model.forward_kinematics(q)
        if np.shape(target) == (3,):  # a position does not turn the tool
            pose[:3, :3] = tool[:3, :3]
        wrench, guard = None, 1.0
        if self.contact is not None:
            load, current, sent = measured
            wrench = self.contact.update(q, dt=dt, load=load, current=current, sent=sent)
            guard = self.contact.guard
        step = 1.0 / controller.settings.rate if dt is None else dt
        self._time = 0.0 if self._time < 0.0 else self._time + step
        reading = np.asarray(q, dtype=np.float64)
        return TickContext(controller, self._time, step, reading, tool, pose, wrench, guard)

    def _finish(self, tick: TickContext, holds: list[bool]) -> None:
        """End the reaction in force if it is over; `holds`: value of `when` of every reaction."""
        running = self._in_force
        if running is not None and (self._ending or running.over(tick, holds[running.index])):
            self._end(tick, running)
        self._ending = False

    def _start(self, tick: TickContext, holds: list[bool]) -> None:
        """Begin reactions whose condition has become true (`holds`), in the order of the list."""
        for index, reaction in enumerate(self.reactions):
            if not holds[index]:
                self._is_armed[index] = True
            elif self._is_armed[index] and reaction.is_one_shot:
                self._is_armed[index] = False
                self.log.append(ReactionEvent(tick.time, "called", reaction, tick.wrench))
                for action in reaction.actions:
                    action.begin(tick)
            elif self._is_armed[index] and (self._in_force is None or index < self._in_force.index):
                self._is_armed[index] = False
                if self._in_force is not None:
                    self._end(tick, self._in_force)
                self._in_force = _InForce(index, reaction, tick)
                self._resuming = False
                self.log.append(ReactionEvent(tick.time, "began", reaction, tick.wrench))

    def _end(self, tick: TickContext, running: _InForce) -> None:
        self._in_force, self._resuming = None, True
        running.end(tick)
        self.log.append(ReactionEvent(tick.time, "ended", running.reaction, tick.wrench))

    def __repr__(self) -> str:
        active = "nothing in force" if self.active is None else f"in force: {self.active!r}"
        return f"<ReactionMonitor: {len(self.reactions)} reactions, {active}>"
