"""Stand-in for the link to the page: it sends scripted messages and records the snapshots."""

from __future__ import annotations

import pytest

pytest.importorskip("viser", reason="the page needs viser: pip install 'pliant[view]'")
pytest.importorskip("mjviser", reason="the page needs mjviser: pip install 'pliant[view]'")

from pliant.view.snapshot import Ended


class Script:
    """Stand-in for a `Link` with scripted messages.

    `by_call` maps the number of a call of `messages()` to the messages that this call returns.
    """

    def __init__(self, by_call, period=3):
        self.at, self.every = dict(by_call), period
        self.calls = 0
        self.infos, self.snapshots, self.watchers, self.ends = [], [], [], []

    def messages(self):
        self.calls += 1
        orders = self.at.pop(self.calls, ())
        return list(orders) if isinstance(orders, list | tuple) else [orders]

    def due(self):
        return self.calls % self.every == 0

    def send(self, message):
        if isinstance(message, Ended):
            self.ends.append(message)
            return
        is_snapshot = hasattr(message, "qpos")
        (self.snapshots if is_snapshot else self.infos).append(message)

    @property
    def running(self):
        return [s for s in self.snapshots if s.phase == "running"]


@pytest.fixture(scope="session")
def script():
    return Script
