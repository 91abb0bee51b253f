"""Bytes and names of ROS 2 messages on a zenoh network, as rmw_zenoh defines them.

The functions follow the design document of rmw_zenoh for key expressions, liveliness tokens, QoS
texts and attachments. CDR and type hashes (REP 2016) come from `rosbags`.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

try:
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
except ImportError as error:
    from pliant._extras import missing

    raise ImportError(missing("ROS 2 messages", "ros")) from error

if TYPE_CHECKING:
    from collections.abc import Mapping

#: QoS of all topics but the latched one: reliable, volatile, last 10.
QOS = "::,10:,:,:,,"
#: QoS of the latched topic: reliable, transient local, last 1.
LATCHED_QOS = ":1:,1:,:,:,,"
#: Requests and responses of the parameter services of a ROS 2 node.
SERVICES = {
    "rcl_interfaces/srv/GetParameters": (
        "string[] names\n",
        "rcl_interfaces/ParameterValue[] values\n",
    ),
    "rcl_interfaces/srv/GetParameterTypes": ("string[] names\n", "uint8[] types\n"),
    "rcl_interfaces/srv/ListParameters": (
        "string[] prefixes\nuint64 depth\n",
        "rcl_interfaces/ListParametersResult result\n",
    ),
    "rcl_interfaces/srv/DescribeParameters": (
        "string[] names\n",
        "rcl_interfaces/ParameterDescriptor[] descriptors\n",
    ),
    "rcl_interfaces/srv/SetParameters": (
        "rcl_interfaces/Parameter[] parameters\n",
        "rcl_interfaces/SetParametersResult[] results\n",
    ),
    "rcl_interfaces/srv/SetParametersAtomically": (
        "rcl_interfaces/Parameter[] parameters\n",
        "rcl_interfaces/SetParametersResult result\n",
    ),
}
_EVENT_INFO = """uint8 event_type
builtin_interfaces/Time stamp
uint8[16] client_gid
int64 sequence_number
"""


def _make_store() -> Any:
    """Return the message types of ROS 2 Jazzy that are used here, and those of `SERVICES`."""
    jazzy = get_typestore(Stores.ROS2_JAZZY).fielddefs
    packages = ("builtin_interfaces", "geometry_msgs", "rcl_interfaces", "sensor_msgs", "std_msgs")
    types = {
        name: definition
        for name, definition in jazzy.items()
        if name.startswith((*packages, "tf2_msgs"))
    }
    # rosbags does not hash `char` as uint8, which it is in ROS 2.
    types |= get_types_from_msg(_EVENT_INFO, "service_msgs/msg/ServiceEventInfo")
    for name, (request, response) in SERVICES.items():
        types |= service_types(name, request, response)
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


def service_types(name: str, request: str, response: str) -> dict[str, Any]:
    """Return the types of a service: request, response, event, and the service type to hash.

    Args:
        name: Name of the service type, such as "example_interfaces/srv/AddTwoInts".
        request: Definition of the request.
        response: Definition of the response.
    """
    event = f"service_msgs/ServiceEventInfo info\n{name}_Request[<=1] request\n"
    texts = {
        f"{name}_Request": request,
        f"{name}_Response": response,
        f"{name}_Event": f"{event}{name}_Response[<=1] response\n",
        name: f"{name}_Request request_message\n{name}_Response response_message\n"
        f"{name}_Event event_message\n",
    }
    out: dict[str, Any] = {}
    for full, text in texts.items():
        for key, definition in get_types_from_msg(text, full).items():
            out[_without_msg(key)] = _without_msg(definition)
    return out


def _without_msg(value: Any) -> Any:
    """Replace "/srv/msg/" of rosbags by "/srv/" in all names of a definition."""
    if isinstance(value, str):
        return value.replace("/srv/msg/", "/srv/")
    if type(value) in (tuple, list):
        return type(value)(_without_msg(item) for item in value)
    return value


STORE = _make_store()


def encode(name: str, message: Mapping[str, Any]) -> bytes:
    """Return the CDR bytes of a message from its fields; missing fields are zero or empty."""
    return bytes(STORE.serialize_cdr(make(name, message), name))


def decode(name: str, data: bytes) -> Any:
    """Return a message of a type from CDR bytes, as an object with its fields.

    Raises:
        ValueError: The bytes are not a message of the type.
    """
    try:
        return STORE.deserialize_cdr(data, name)
    # rosbags does not check the bytes: invalid ones may raise any error of struct, NumPy or
    # Unicode.
    except Exception as error:
        raise ValueError(f"{len(data)} bytes are not a {name}: {error}") from error


def make(name: str, fields: Any) -> Any:
    """Return a message of a type from a dictionary of fields; missing fields are zero or empty.

    Raises:
        TypeError, ValueError: A field is unknown, or has a value of another type.
    """
    known = dict(STORE.fielddefs[name][1])
    if not isinstance(fields, dict) or set(fields) - set(known):
        raise ValueError(f"a {name} has the fields {', '.join(known)}, got {fields!r:.80}")
    values = {key: _value(kind, fields.get(key)) for key, kind in known.items()}
    if not known:
        values = {"structure_needs_at_least_one_member": 0}
    return STORE.types[name](**values)


def _value(kind: Any, value: Any) -> Any:
    """Return the value of a field of a kind; None gives the default value."""
    node, detail = kind
    if node == Nodetype.NAME:
        return make(detail, {} if value is None else value)
    if node == Nodetype.BASE:
        converters: dict[str, Any] = {"string": str, "bool": bool, "float32": float}
        convert = converters.get(detail[0], float if detail[0] == "float64" else int)
        return convert() if value is None else convert(value)
    inner, _ = detail
    items = [] if value is None else list(value)
    if inner[0] == Nodetype.BASE and inner[1][0] != "string":
        base = inner[1][0]
        return np.array(items, dtype={"byte": "uint8", "char": "uint8"}.get(base, base))
    return [_value(inner, item) for item in items]


def dds_type(name: str) -> str:
    """Return the DDS name of a type: "std_msgs::msg::dds_::String_" for "std_msgs/msg/String"."""
    package, kind, short = name.split("/")
    return f"{package}::{kind}::dds_::{short}_"


def key_expression(domain: int, topic: str, type_name: str) -> str:
    """Return the key expression of a topic or service in a ROS domain."""
    return f"{domain}/{topic.strip('/')}/{dds_type(type_name)}/{STORE.hash_rihs01(type_name)}"


class NodeName(NamedTuple):
    """Name of a ROS 2 node.

    Attributes:
        domain: ROS domain id.
        namespace: Namespace, "/" or "/left".
        name: Name without the namespace.
    """

    domain: int
    namespace: str
    name: str

    def resolve(self, topic: str) -> str:
        """Return the full name of a topic: absolute, relative to the namespace, or "~/..."."""
        if topic.startswith("/"):
            return topic
        inside = topic.replace("~", self.name, 1) if topic.startswith("~/") else topic
        return f"{self.namespace.rstrip('/')}/{inside}"

    def token(self, session: str, number: int = 0, entity: str = "NN") -> str:
        """Return the liveliness token of the node, or the start of the token of an entity.

        Args:
            session: Id of the zenoh session.
            number: Number of the entity in the session; 0: the node.
            entity: "NN" node, "MP" publisher, "MS" subscription, "SS" service.
        """
        space = self.namespace.replace("/", "%")
        return f"@ros2_lv/{self.domain}/{session}/0/{number}/{entity}/%/{space}/{self.name}"


def entity_token(start: str, topic: str, type_name: str, qos: str) -> str:
    """Return the liveliness token of a publisher, subscription or service.

    Args:
        start: Start of the token, `NodeName.token` of the entity.
        topic: Full name of the topic or service.
        type_name: Its type.
        qos: `QOS` or `LATCHED_QOS`.
    """
    mangled = topic.replace("/", "%")
    return f"{start}/{mangled}/{dds_type(type_name)}/{STORE.hash_rihs01(type_name)}/{qos}"


def attachment(sequence: int, time: int, gid: bytes) -> bytes:
    """Return the attachment of a message: number, time [ns] and id (16 bytes) of the sender."""
    return struct.pack("<qqB", sequence, time, len(gid)) + gid
