"""Deterministic scheduler: the threads of a program run one at a time, in the order of a plan.

Tasks are real threads. Another task may continue at every traced line of the code under test, and
at every call of a lock, event, clock or pipe of this module. Time is virtual: it advances to the
next deadline once no task can run. The same plan therefore gives the same run.
"""

from __future__ import annotations

import gc
import signal
import sys
import threading
from collections import deque
from types import SimpleNamespace


class Killed(BaseException):
    """Raised in a task to end it after the end of its process."""


class Stuck(AssertionError):
    """All tasks wait forever, or the run takes too many steps."""


class Plan:
    """Actions by step number; in a step without an action the current task continues.

    ("switch", k): continue the k-th of the other tasks that can run now or after a timed wait;
    ("signal", number); ("kill", None): SIGKILL; ("call", function).
    """

    def __init__(self, actions=()):
        self.actions = dict(actions)

    def __repr__(self):
        return f"Plan({sorted(self.actions.items())})"


class Task:
    """Thread of a process; a waiting task continues if `ready()` is True, or at its `deadline`."""

    def __init__(self, name, process):
        self.name, self.process = name, process
        self.baton = threading.Semaphore(0)
        self.ready, self.deadline = None, None
        self.is_done = self.is_killed = False


class Scheduler:
    """Runs a program and its threads by a plan.

    Args:
        plan: The plan.
        files: Ends of the paths of files in which every line is a step.
        on_step: Called before every step; raises if an invariant does not hold.
        limit: Largest number of steps.
    """

    def __init__(self, plan, files=(), on_step=lambda: None, limit=200_000):
        self.plan, self._files, self.on_step, self._limit = plan, tuple(files), on_step, limit
        self.now, self.steps = 0.0, 0
        self.main = self.current = Task("main", "program")
        self.tasks, self.pending, self._threads = [self.main], deque(), []
        self.ended, self._is_over, self.error = set(), False, None
        self.delivered, self._is_checking = [], False
        self._known = {}

    # Decisions of the plan.

    def step(self):
        """Count a step of the current task and execute the action of the plan for this step."""
        task = self.current
        self._check(task)
        self.steps += 1
        if self.steps > self._limit:
            self._fail(Stuck(f"no end after {self.steps} steps at {self.now:.2f} s"))
        self.check()
        kind, value = self.plan.actions.get(self.steps, (None, None))
        if kind == "switch":
            others = [t for t in self.tasks if t is not task and self._can_run(t, may_wait=True)]
            if others:
                other = others[value % len(others)]
                if not self._can_run(other):
                    self.now = max(self.now, other.deadline)
                self._hand_over(other)
        elif kind == "signal":
            self.pending.append(value)
            if task is not self.main and not self.main.is_killed:
                self._hand_over(self.main)
        elif kind == "kill":
            self.end("program")
        elif kind == "call":
            value()
        self._check(task)
        if task is self.main:
            self._deliver()

    def check(self):
        """Check the invariants; lines of the code that they call do not count as steps."""
        self._is_checking = True
        try:
            self.on_step()
        except AssertionError as error:
            self._fail(error)
        finally:
            self._is_checking = False

    def _deliver(self):
        while self.pending:
            number = self.pending.popleft()
            if "program" in self.ended:
                continue
            self.delivered.append(number)
            signal.raise_signal(number)

    def _fail(self, error):
        self.error = self.error or error
        self._is_over = True
        raise Killed

    def _check(self, task):
        if self._is_over or task.is_killed:
            if task.process in self.ended and not self._is_over:
                self._park(task)
            raise Killed

    def end(self, process):
        """End a process: its tasks never run again."""
        self.ended.add(process)
        for task in self.tasks:
            if task.process == process:
                task.is_killed = True

    # Tasks.

    def _can_run(self, task, *, may_wait=False):
        """Return True if a task can run; with `may_wait`, also if it can after its deadline."""
        if task.is_done or task.is_killed:
            return False
        if may_wait and task.deadline is not None:
            return True
        if task.ready is None and task.deadline is None:
            return True
        is_due = task.deadline is not None and task.deadline <= self.now
        return is_due or (task.ready is not None and task.ready())

    def _hand_over(self, task):
        """Continue another task, and wait until this one is continued."""
        this = self.current
        self.current = task
        task.baton.release()
        this.baton.acquire()
        if self._is_over:
            raise Killed

    def _park(self, task):
        """Suspend a task of a process that has ended, until the end of the run."""
        following = self._next()
        if following is None:
            self._is_over = True
            raise Killed
        self._hand_over(following)
        raise Killed

    def _next(self):
        """Return the task that runs next if the current one cannot; None: no task can ever run."""
        while True:
            for task in self.tasks:
                if self._can_run(task):
                    return task
            waiting = [t for t in self.tasks if not t.is_done and not t.is_killed]
            times = [t.deadline for t in waiting if t.deadline is not None]
            if not times:
                return None
            self.now = max(self.now, min(times))

    def wait(self, ready=None, deadline=None):
        """Wait until `ready()` is True or the deadline; a signal may end a wait of the main task.

        Returns:
            False if the deadline passed first.
        """
        self.retrace()
        self.step()
        task = self.current
        while True:
            if ready is not None and ready():
                return True
            if deadline is not None and deadline <= self.now:
                return False
            task.ready, task.deadline = ready, deadline
            following = self._next()
            if following is None:
                self._fail(Stuck(f"{task.name} waits for ever at {self.now:.2f} s"))
            if following is not task:
                self._hand_over(following)
            task.ready = task.deadline = None
            self._check(task)
            if task is self.main:
                self._deliver()

    def spawn(self, name, function, process="program"):
        """Start a task."""
        task = Task(name, process)

        def work():
            task.baton.acquire()
            try:
                if not self._is_over:
                    sys.settrace(self._trace)
                    function()
            except Killed:
                pass
            except BaseException as error:
                self.error = self.error or error
                self._is_over = True
            finally:
                sys.settrace(None)
                task.is_done = True
                following = None if self._is_over else self._next()
                if following is None:
                    self._is_over = True
                    following = self.main
                self.current = following
                following.baton.release()

        self.tasks.append(task)
        thread = threading.Thread(target=work, name=name, daemon=True)
        self._threads.append((task, thread))
        thread.start()
        return task

    def run(self, program):
        """Run the main program, then the other processes, to their end; raise their first error."""
        before = sys.gettrace()
        # Otherwise generators of an earlier run would execute traced lines when they are deleted.
        gc.collect(1)
        gc.disable()
        sys.settrace(self._trace)
        try:
            program()
            self.main.process = "end"
            self.end("program")
            self.wait(lambda: all(t.is_done or t.is_killed for t in self.tasks[1:]))
        except Killed:
            pass
        finally:
            sys.settrace(before)
            gc.enable()
            self._is_over = True
            for task, thread in self._threads:
                while thread.is_alive():
                    task.baton.release()
                    thread.join(0.5)
        if self.error is not None:
            raise self.error

    # Steps at every line.

    def _trace(self, frame, event, argument):
        code = frame.f_code
        if code not in self._known:
            self._known[code] = code.co_filename.endswith(self._files) if self._files else False
        return self._trace_line if self._known[code] else None

    def _trace_line(self, frame, event, argument):
        if event == "line" and not (self._is_checking or self._is_over):
            self.step()
        return self._trace_line

    def retrace(self):
        """Trace this thread again: an exception in the trace function ends tracing."""
        if sys.gettrace() is not None or self._is_over:
            return
        frame = sys._getframe(1)
        while frame is not None:
            if frame.f_code.co_filename.endswith(self._files):
                frame.f_trace = self._trace_line
            frame = frame.f_back
        sys.settrace(self._trace)

    # Stand-ins for modules `threading` and `time`, and for pipes.

    @property
    def threading(self):
        """Stand-in for the module `threading`."""
        return SimpleNamespace(
            Lock=lambda: Lock(self),
            RLock=lambda: Lock(self),
            Event=lambda: Event(self),
            Thread=lambda target, args=(), name="", daemon=None: SimpleNamespace(
                start=lambda: self.spawn(name, lambda: target(*args), self.current.process)
            ),
            TIMEOUT_MAX=threading.TIMEOUT_MAX,
            current_thread=threading.current_thread,
            main_thread=threading.main_thread,
        )

    @property
    def time(self):
        """Stand-in for the module `time`."""

        def now():
            return self.now

        return SimpleNamespace(
            perf_counter=now,
            monotonic=now,
            sleep=lambda seconds: self.wait(deadline=self.now + seconds),
        )


class Lock:
    """Reentrant lock of the virtual module `threading`."""

    def __init__(self, scheduler):
        self._scheduler, self.owner, self._depth = scheduler, None, 0

    def acquire(self, blocking=True, timeout=-1):
        scheduler, task = self._scheduler, self._scheduler.current
        deadline = scheduler.now + timeout if timeout >= 0 else None
        if not scheduler.wait(lambda: self.owner in (None, task), deadline):
            return False
        self.owner, self._depth = task, self._depth + 1
        return True

    def release(self):
        scheduler = self._scheduler
        if scheduler._is_over:
            return
        assert self.owner is scheduler.current
        self._depth -= 1
        if not self._depth:
            self.owner = None
        scheduler.retrace()
        scheduler.step()

    def __enter__(self):
        self.acquire()

    def __exit__(self, *_):
        self.release()


class Event:
    """Event of the virtual module `threading`."""

    def __init__(self, scheduler):
        self._scheduler, self._is_set = scheduler, False

    def is_set(self):
        return self._is_set

    def set(self):
        self._is_set = True

    def clear(self):
        self._is_set = False

    def wait(self, timeout=None):
        deadline = None if timeout is None else self._scheduler.now + timeout
        return self._scheduler.wait(self.is_set, deadline) and self._is_set


class Clock:
    """Clock of a drive in virtual time; `real_time` is True as for a real bus."""

    real_time = True

    def __init__(self, scheduler):
        self._scheduler = scheduler

    def now(self):
        return self._scheduler.now

    def wait_until(self, deadline):
        self._scheduler.wait(deadline=deadline)


class Pipe:
    """One end of a connection between two processes."""

    def __init__(self, scheduler, process):
        self._scheduler, self._process = scheduler, process
        self.received, self.other, self.is_closed = deque(), None, False

    @staticmethod
    def pair(scheduler, first, second):
        ends = Pipe(scheduler, first), Pipe(scheduler, second)
        ends[0].other, ends[1].other = ends[1], ends[0]
        return ends

    @property
    def has_ended(self):
        return self.other.is_closed or self.other._process in self._scheduler.ended

    def is_ready(self):
        return bool(self.received) or self.has_ended

    def send(self, content):
        self._scheduler.retrace()
        self._scheduler.step()
        if self.is_closed or self.has_ended:
            raise BrokenPipeError
        self.other.received.append(content)

    def poll(self, timeout):
        return self._scheduler.wait(self.is_ready, self._scheduler.now + timeout)

    def recv(self):
        self._scheduler.wait(self.is_ready)
        if not self.received:
            raise EOFError
        return self.received.popleft()

    def close(self):
        self.is_closed = True
