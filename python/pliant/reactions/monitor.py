"""The monitor: evaluates all reactions once per tick and has at most one in force."""

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
        when: Condition; the actions begin when it becomes true.
        then: One action or several, in the order in which they change the target.
        until: Condition that ends the actions. By default they end when `when` has been false for
            `clear`, and `Retract` and `Stop` only by `ReactionMonitor.resume()`.
        clear: See `until` [s].
    """

    when: Condition
    then: Action | Sequence[Action]
    until: Condition | None = None
    clear: float = 0.5

    def __post_init__(self) -> None:
        """Check the parts once."""
        condition(self.when, "Reaction.when")
        if self.until is not None:
            condition(self.until, "Reaction.until")
        listed = isinstance(self.then, Action | Sequence)
        if not (listed and self.actions and all(isinstance(one, Action) for one in self.actions)):
            raise ConfigError(
                "Reaction.then must be an action, as Hold() or Retract(0.05), or several in a "
                f"list, got {format_value(self.then)}"
            )
        if self.until is not None and any(isinstance(one, Stop) for one in self.actions):
            raise ConfigError("a Stop ends by ReactionMonitor.resume() alone; use Hold with until")
        number(self.clear, "Reaction.clear", 0.0, unit="s")

    @property
    def actions(self) -> tuple[Action, ...]:
        """The actions as a tuple."""
        return (self.then,) if isinstance(self.then, Action) else tuple(self.then)

    @property
    def is_one_shot(self) -> bool:
        """True if no action stays in force."""
        return all(one.is_one_shot for one in self.actions)

    @property
    def needs_force(self) -> bool:
        """True if a part of it needs a force estimate."""
        ends = self.until is not None and self.until.needs_force
        return self.when.needs_force or ends or any(action.needs_force for action in self.actions)


@dataclass(frozen=True)
class ReactionEvent:
    """An entry of the monitor's log.

    Attributes:
        time: Time since the first update [s]; equal to `Tick.time` if updated in every tick.
        what: `began`, `ended` or `called`.
        reaction: The reaction.
        wrench: Estimated wrench on the tool at that time.
    """

    time: float
    what: Literal["began", "ended", "called"]
    reaction: Reaction
    wrench: WrenchEstimate | None


class _InForce:
    """A reaction in force."""

    def __init__(self, index: int, reaction: Reaction, now: TickContext) -> None:
        self.index, self.reaction = index, reaction
        self._running: list[Running] = [action.begin(now) for action in reaction.actions]
        self._is_latching = any(action.is_latching for action in reaction.actions)
        self._until = None if reaction.until is None else reaction.until.evaluator()
        self._quiet = 0.0

    def target(self, now: TickContext) -> Array:
        """Return the caller's target, changed by all actions in turn."""
        pose = now.target
        for running in self._running:
            pose = running.target(now, pose)
        return pose

    def over(self, now: TickContext, holds: bool) -> bool:
        """Return True if it ends with this tick."""
        if self._until is not None:
            return self._until(now)
        if self._is_latching:
            return False
        answers = [answer for one in self._running if (answer := one.over(now)) is not None]
        if answers:
            return all(answers)
        self._quiet = 0.0 if holds else self._quiet + now.dt
        return self._quiet > self.reaction.clear

    def end(self, now: TickContext) -> None:
        """End the actions, last action first."""
        for running in reversed(self._running):
            running.end(now)


class ReactionMonitor:
    """Reactions of one controller; call `update` once per tick, before its `step`.

    Reactions are in order of priority: a reaction replaces later ones in the list. It begins when
    its condition becomes true, and again only after the condition has been false. After its end the
    target returns to the caller's at `resume_speed`, without a jump.

    Args:
        controller: Its target and settings are changed.
        reactions: In order of priority.
        contact: Contact estimator. None: one with its defaults, if a reaction needs a force.
        resume_speed: Speed at which the target returns [m/s], [rad/s].

    Attributes:
        log: The last thousand beginnings, ends and calls.

    Raises:
        OutOfRangeError: A threshold is below the uncertainty.
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
        self.controller = instance(controller, Controller, "controller")
        if contact is not None:
            instance(contact, ContactEstimator, "contact")
        if not isinstance(reactions, Iterable):
            raise TypeError(f"reactions must be a list of Reaction, got {format_value(reactions)}")
        self.reactions = tuple(instance(one, Reaction, "a reaction") for one in reactions)
        if contact is None and any(reaction.needs_force for reaction in self.reactions):
            contact = ContactEstimator(controller)
        if contact is not None and contact.controller is not controller:
            raise ConfigError("contact is another controller's: make it of this one")
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
        """Restart: no reaction in force, times at zero; a tare of the contact stays.

        Call it with the controller's `reset`. Settings changed by a `Yield` stay changed: call
        `resume` and `update` before, or `controller.update`.
        """
        self._evaluators: list[Evaluator] = [
            reaction.when.evaluator() for reaction in self.reactions
        ]
        self._armed = [True] * len(self.reactions)
        self._in_force, self._resuming, self._ending = None, False, False
        self._out: Array | None = None
        self._time = -1.0
        self.log.clear()
        if self.contact is not None:
            self.contact.reset()

    @property
    def active(self) -> Reaction | None:
        """The reaction in force."""
        return None if self._in_force is None else self._in_force.reaction

    @property
    def stopped(self) -> bool:
        """True if a `Stop` is in force."""
        active = self.active
        return active is not None and any(isinstance(one, Stop) for one in active.actions)

    @property
    def resuming(self) -> bool:
        """True while the target returns to the caller's."""
        return self._resuming

    @property
    def wrench(self) -> WrenchEstimate | None:
        """Estimated wrench on the tool at the last tick; None without a contact estimator."""
        return None if self.contact is None else self.contact.estimate

    def resume(self) -> None:
        """End the reaction in force with the next update."""
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
        """Evaluate one tick.

        Args:
            q: Measured joint positions (n,) [rad].
            target: As for `Controller.step`.
            dt: Time since the last tick [s]; None: 1 / settings.rate.
            load: As for `ContactEstimator.update`.
            current: As for `ContactEstimator.update`.
            sent: As for `ContactEstimator.update`.

        Returns:
            The target for the step: the caller's own object while no reaction is in force.

        Raises:
            ShapeError, OutOfRangeError, ConfigError: An input is invalid; nothing has changed.
            Exception: Error of a called function.
        """
        now = self._collect(q, target, dt, load, current, sent)
        holds = [evaluator(now) for evaluator in self._evaluators]
        self._finish(now, holds)
        self._start(now, holds)
        if self._in_force is not None:
            self._out = self._in_force.target(now)
            return self._out
        if self._resuming and self._out is not None:
            distance, angle = (speed * now.dt for speed in self._resume_speed)
            self._out = step_toward(self._out, now.target, distance, angle)
            self._resuming = self._out is not now.target
            return self._out if self._resuming else target
        return target

    def _collect(self, q: Any, target: Any, dt: float | None, *measured: Any) -> TickContext:
        """Collect the data of this tick."""
        controller = self.controller
        pose = functional.as_pose(target).matrix
        tool = controller.model.forward_kinematics(q)
        wrench, guard = None, 1.0
        if self.contact is not None:
            load, current, sent = measured
            wrench = self.contact.update(q, dt=dt, load=load, current=current, sent=sent)
            guard = self.contact.guard
        step = 1.0 / controller.settings.rate if dt is None else dt
        self._time = 0.0 if self._time < 0.0 else self._time + step
        reading = np.asarray(q, dtype=np.float64)
        return TickContext(controller, self._time, step, reading, tool, pose, wrench, guard)

    def _finish(self, now: TickContext, holds: list[bool]) -> None:
        """End the reaction in force if it is over."""
        running = self._in_force
        if running is not None and (self._ending or running.over(now, holds[running.index])):
            self._end(now, running)
            self._resuming = True
        self._ending = False

    def _start(self, now: TickContext, holds: list[bool]) -> None:
        """Begin reactions whose condition has become true."""
        for index, reaction in enumerate(self.reactions):
            if not holds[index]:
                self._armed[index] = True
            elif self._armed[index] and reaction.is_one_shot:
                self._armed[index] = False
                self.log.append(ReactionEvent(now.time, "called", reaction, now.wrench))
                for action in reaction.actions:
                    action.begin(now)
            elif self._armed[index] and (self._in_force is None or index < self._in_force.index):
                self._armed[index] = False
                if self._in_force is not None:
                    self._end(now, self._in_force)
                self._in_force = _InForce(index, reaction, now)
                self._resuming = False
                self.log.append(ReactionEvent(now.time, "began", reaction, now.wrench))

    def _end(self, now: TickContext, running: _InForce) -> None:
        self._in_force = None
        running.end(now)
        self.log.append(ReactionEvent(now.time, "ended", running.reaction, now.wrench))

    def __repr__(self) -> str:
        active = "nothing in force" if self.active is None else f"in force: {self.active!r}"
        return f"<ReactionMonitor: {len(self.reactions)} reactions, {active}>"
