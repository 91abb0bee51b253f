"""Process of the ROS 2 node: ``python -m pliant.ros.node DESCRIPTOR OPTIONS``, OPTIONS in JSON.

It implements the protocol of rmw_zenoh on zenoh, and needs no ROS. `ros_link` starts it.
"""

from __future__ import annotations

import itertools
import json
import re
import sys
import threading
import time
import uuid
from typing import TYPE_CHECKING, Any

from pliant.ros import wire
from pliant.ros.interface import DESCRIPTION, PUBLISHED, SUBSCRIBED, ArmInterface
from pliant.ros.parameters import ParameterServices
from pliant.view.ipc import PageEndpoint, Ready, StartupError

try:
    import zenoh
    import zenoh.ext
except ImportError as error:
    from pliant._extras import missing

    raise ImportError(missing("pliant ros", "ros")) from error

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

#: Minimum time between two handled messages of one topic [s]; of the messages that come earlier,
#: only the last is handled.
PERIOD = 0.005


class Node:
    """A ROS 2 node on a zenoh session.

    Args:
        session: The session.
        name: Name of the node.
    """

    def __init__(self, session: zenoh.Session, name: wire.NodeName) -> None:
        """Announce the node in the network."""
        self._session, self._name = session, name
        self._zid = str(session.info.zid())
        self._numbers = itertools.count(1)
        self._entities: list[Any] = []
        self._threads: list[threading.Thread] = []
        self._announce(name.token(self._zid))

    def close(self) -> None:
        """Undeclare all entities, and wait for the threads that handle messages.

        Python would abort the process if a thread still waited in zenoh at the end.
        """
        for entity in reversed(self._entities):
            entity.undeclare()
        for thread in self._threads:
            thread.join()

    def _announce(self, token: str) -> None:
        self._entities.append(self._session.liveliness().declare_token(token))

    def _declare(self, entity: str, topic: str, type_name: str, qos: str) -> str:
        """Announce an entity, and return the key expression of its topic."""
        full = self._name.resolve(topic)
        start = self._name.token(self._zid, next(self._numbers), entity)
        self._announce(wire.entity_token(start, full, type_name, qos))
        return wire.key_expression(self._name.domain, full, type_name)

    def publisher(
        self, topic: str, type_name: str, *, latched: bool = False
    ) -> Callable[[Mapping[str, Any]], None]:
        """Return a function that publishes a message, given as a dictionary, without waiting.

        Args:
            topic: Topic: absolute, relative to the namespace, or "~/...".
            type_name: Message type.
            latched: True: keep the last message for late subscribers (transient local).
        """
        key = self._declare("MP", topic, type_name, wire.LATCHED_QOS if latched else wire.QOS)
        drop = zenoh.CongestionControl.DROP
        publisher: Any
        if latched:
            publisher = zenoh.ext.declare_advanced_publisher(
                self._session,
                key,
                congestion_control=drop,
                cache=zenoh.ext.CacheConfig(max_samples=1),
                publisher_detection=True,
            )
        else:
            publisher = self._session.declare_publisher(key, congestion_control=drop)
        self._entities.append(publisher)
        gid, count = uuid.uuid4().bytes, itertools.count(1)

        def publish(message: Mapping[str, Any]) -> None:
            attachment = wire.attachment(next(count), time.time_ns(), gid)
            publisher.put(wire.encode(type_name, message), attachment=attachment)

        return publish

    def subscribe(self, topic: str, type_name: str, handle: Callable[[bytes], None]) -> None:
        """Call `handle` in a thread with the bytes of each message, at most once per `PERIOD`.

        A new message replaces an older one that has not been handled yet.
        """
        key = self._declare("MS", topic, type_name, wire.QOS)
        newest: Any = zenoh.handlers.RingChannel(1)
        subscriber: Any = self._session.declare_subscriber(key, newest)
        self._entities.append(subscriber)

        def listen() -> None:
            for sample in subscriber:
                handle(sample.payload.to_bytes())
                time.sleep(PERIOD)

        thread = threading.Thread(target=listen, daemon=True, name=f"pliant-ros-{topic}")
        self._threads.append(thread)
        thread.start()

    def serve(
        self, service: str, type_name: str, answer: Callable[[Any], Mapping[str, Any]]
    ) -> None:
        """Answer the requests of a service.

        Args:
            service: Name of the service, in the form of a topic.
            type_name: Service type, a key of `wire.SERVICES`.
            answer: Function that returns the response to a request.
        """
        key = self._declare("SS", service, type_name, wire.QOS)
        gid = uuid.uuid4().bytes

        def reply(query: zenoh.Query) -> None:
            payload, header = query.payload, query.attachment
            if payload is None or header is None:
                query.reply_err(f"a request of {service} needs a payload and an attachment")
                return
            try:
                request = wire.decode(f"{type_name}_Request", payload.to_bytes())
                response = wire.encode(f"{type_name}_Response", answer(request))
                sequence = int.from_bytes(header.to_bytes()[:8], "little", signed=True)
                attachment = wire.attachment(sequence, time.time_ns(), gid)
            except (ValueError, TypeError, OverflowError) as error:
                query.reply_err(str(error))
                return
            query.reply(query.key_expr, response, attachment=attachment)

        queryable: Any = self._session.declare_queryable(key, reply, complete=True)
        self._entities.append(queryable)


def open_session(listen: str, connect: str) -> zenoh.Session:
    """Open a zenoh session: a router that listens, or a client of the router `connect`.

    Raises:
        zenoh.ZError: An address is invalid or taken, or no router answers.
    """
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    # zenoh keeps the last message for late subscribers only with time stamps.
    config.insert_json5("timestamping/enabled", "true")
    config.insert_json5("mode", json.dumps("client" if connect else "router"))
    config.insert_json5("listen/endpoints", json.dumps([] if connect else [listen]))
    if connect:
        config.insert_json5("connect/endpoints", json.dumps([connect]))
    return zenoh.open(config)


def run_arm(node: Node, arm: ArmInterface, endpoint: PageEndpoint) -> None:
    """Publish the states from the control loop until it ends; handle messages from the network."""
    published = {topic: node.publisher(topic, kind) for topic, kind in PUBLISHED.items()}
    node.publisher(DESCRIPTION, "std_msgs/msg/String", latched=True)({"data": arm.urdf})

    def listen(topic: str, kind: str) -> None:
        def handle(data: bytes) -> None:
            try:
                message = wire.decode(kind, data)
            except ValueError as error:
                arm.refuse(topic, error)
                return
            arm.receive(topic, message)

        node.subscribe(topic, kind, handle)

    for topic, kind in SUBSCRIBED.items():
        listen(topic, kind)
    services = ParameterServices(arm)
    for name, (kind, answer) in services.by_name.items():
        node.serve(f"~/{name}", kind, answer)
    while (state := endpoint.receive()) is not None:
        for topic, message in arm.publish(state):
            published[topic](message)


def main(descriptor: int, options: dict[str, Any]) -> int:
    """Run the node until the control loop ends; return the exit code of the process."""
    endpoint = PageEndpoint(descriptor)
    listen, connect = options["listen"], options["connect"]
    try:
        session = open_session(listen, connect)
    except zenoh.ZError as error:
        # Remove places in zenoh's source code.
        reason = re.sub(r" at /\S+\.rs:\d+", "", str(error)).rstrip(".! ")
        text = (
            f"no zenoh router at {connect}: {reason}. Start one (ros2 run rmw_zenoh_cpp "
            "rmw_zenohd), or leave --connect out"
            if connect
            else f"zenoh cannot listen on {listen}: {reason}. If a router (rmw_zenohd) runs there: "
            f"--connect {listen}"
        )
        endpoint.send(StartupError(text))
        return 1
    with session:
        name = wire.NodeName(options["domain"], options["namespace"], options["name"])
        endpoint.send(Ready(connect or listen))
        info = endpoint.receive()
        if info is not None:
            node = Node(session, name)
            run_arm(node, ArmInterface(info, endpoint.queue), endpoint)
            node.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), json.loads(sys.argv[2])))
