"""Process of the Foxglove server: ``python -m pliant.ros.foxglove_server DESCRIPTOR OPTIONS``.

It sends the same messages as the ROS 2 node. `foxglove_link` starts it.
"""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

from pliant import _ros_messages as ros
from pliant._core import PliantError
from pliant.ros import wire
from pliant.ros.interface import DESCRIPTION, PUBLISHED, SUBSCRIBED, ArmInterface
from pliant.view.ipc import PageEndpoint, Ready, StartupError

try:
    import foxglove
    from foxglove import Channel, Context, Parameter, Schema
    from foxglove.websocket import Capability, ServerListener
except ImportError as error:
    from pliant._extras import missing

    raise ImportError(missing("pliant foxglove", "foxglove")) from error

if TYPE_CHECKING:
    from foxglove.websocket import ChannelView, Client, ClientChannel

#: Name of the node in topics, in place of `~`.
NAME = wire.NodeName(0, "/", "pliant")


class Listener(ServerListener):
    """Handles what clients of the server send.

    Attributes:
        arm: Topics and parameters of the arm; None until the control loop has described it.
        description: Channel of the URDF; None until the control loop has described the arm.
    """

    def __init__(self) -> None:
        """Start without an arm."""
        self.arm: ArmInterface | None = None
        self.description: Channel | None = None
        self._topics = {NAME.resolve(topic): topic for topic in SUBSCRIBED}
        #: Topic and encoding of each channel that a client has announced, by client and channel.
        self._advertised: dict[tuple[int, int], tuple[str, str]] = {}

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Send the URDF again when a client subscribes to it."""
        if self.description is not None and channel.id == self.description.id():
            self.send_description()

    def send_description(self) -> None:
        """Send the URDF to all clients that have subscribed to it."""
        if self.arm is not None and self.description is not None:
            self.description.log(wire.encode(ros.STRING, {"data": self.arm.urdf}))

    def on_client_advertise(self, client: Client, channel: ClientChannel) -> None:
        """Store the topic of a channel that a client announces."""
        self._advertised[client.id, channel.id] = channel.topic, channel.encoding

    def on_client_unadvertise(self, client: Client, client_channel_id: int) -> None:
        """Remove a channel that a client no longer announces."""
        self._advertised.pop((client.id, client_channel_id), None)

    def on_message_data(self, client: Client, client_channel_id: int, data: bytes) -> None:
        """Handle a message of a client, in CDR or JSON."""
        full, encoding = self._advertised.get((client.id, client_channel_id), ("", ""))
        topic = self._topics.get(full)
        if self.arm is None or topic is None:
            return
        kind = SUBSCRIBED[topic]
        try:
            if encoding == "cdr":
                message = wire.decode(kind, data)
            else:
                message = wire.make(kind, json.loads(data))
        except (TypeError, ValueError, RecursionError) as error:
            self.arm.refuse(topic, error)
            return
        self.arm.receive(topic, message)

    def on_get_parameters(
        self, client: Client, param_names: list[str], request_id: str | None = None
    ) -> list[Parameter]:
        """Return the named parameters; all of them if no name is given."""
        known: dict[str, Any] = {} if self.arm is None else self.arm.parameters
        return [
            Parameter(name, value=value)
            for name, value in known.items()
            if not param_names or name in param_names
        ]

    def on_set_parameters(
        self, client: Client, parameters: list[Parameter], request_id: str | None = None
    ) -> list[Parameter]:
        """Set the parameters that are accepted; return the resulting values."""
        if self.arm is not None:
            for parameter in parameters:
                try:
                    self.arm.set_parameters({parameter.name: parameter.get_value()})
                except PliantError:
                    continue  # reported; the client sees the value in force
        return self.on_get_parameters(client, [parameter.name for parameter in parameters])


def main(descriptor: int, options: dict[str, Any]) -> int:
    """Run the server until the control loop ends; return the exit code of the process."""
    endpoint = PageEndpoint(descriptor)
    host, port = options["host"], options["port"]
    listener, context = Listener(), Context()
    commands = [Capability.ClientPublish, Capability.Parameters]
    try:
        server = foxglove.start_server(
            name="pliant",
            host=host,
            port=port,
            capabilities=commands if options["allow_commands"] else [],
            server_listener=listener,
            supported_encodings=["cdr", "json"],
            context=context,
        )
    except (OSError, RuntimeError) as error:
        endpoint.send(StartupError(f"Foxglove's server cannot listen on {host}:{port}: {error}"))
        return 1
    endpoint.send(Ready(f"ws://{host}:{server.port}"))
    info = endpoint.receive()
    if info is not None:
        listener.arm = arm = ArmInterface(info, endpoint.queue)
        channels = {topic: _channel(topic, kind, context) for topic, kind in PUBLISHED.items()}
        listener.description = _channel(DESCRIPTION, ros.STRING, context)
        while (state := endpoint.receive()) is not None:
            for topic, message in arm.publish(state):
                channels[topic].log(wire.encode(PUBLISHED[topic], message), log_time=state.time)
    server.stop()
    return 0


def _channel(topic: str, kind: str, context: Context) -> Channel:
    """Return a channel for messages of a type in CDR."""
    schema = Schema(name=kind, encoding="ros2msg", data=ros.DEFINITIONS[kind].encode())
    return Channel(NAME.resolve(topic), schema=schema, message_encoding="cdr", context=context)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), json.loads(sys.argv[2])))
