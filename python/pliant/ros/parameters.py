"""`ParameterServices`: the parameter services of a ROS 2 node for the parameters of an arm."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pliant._core import PliantError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pliant.ros.interface import ArmInterface

    Answer = Callable[[Any], Mapping[str, Any]]

#: Values of rcl_interfaces/msg/ParameterType: no value, a double, a text, a list of doubles.
NOT_SET, DOUBLE, TEXT, DOUBLES = 0, 3, 4, 8
#: Field of a ParameterValue that holds the value, by type. Bool (1) and lists of bytes, bools or
#: texts are rejected: no parameter has these types.
VALUE_FIELDS = {
    2: "integer_value",
    DOUBLE: "double_value",
    TEXT: "string_value",
    7: "integer_array_value",
    DOUBLES: "double_array_value",
}


class ParameterServices:
    """Answers the parameter services of a node: get, set, list and describe.

    Args:
        arm: Topics and parameters of the arm.

    Attributes:
        by_name: Type and answering function of each service by its name below "~/".
    """

    def __init__(self, arm: ArmInterface) -> None:
        """Create the table of services."""
        self._arm = arm
        answers: dict[str, Answer] = {
            "GetParameters": lambda request: {"values": self._values(request.names)},
            "GetParameterTypes": lambda request: {
                "types": [value["type"] for value in self._values(request.names)]
            },
            "ListParameters": self._list,
            "DescribeParameters": self._describe,
            "SetParameters": lambda request: {
                "results": [self._set([parameter]) for parameter in request.parameters]
            },
            "SetParametersAtomically": lambda request: {"result": self._set(request.parameters)},
        }
        self.by_name = {
            _snake(short): (f"rcl_interfaces/srv/{short}", answer)
            for short, answer in answers.items()
        }

    def _values(self, names: list[str]) -> list[dict[str, Any]]:
        """Return a ParameterValue for each name; an unknown name gives the type "not set"."""
        known = self._arm.parameters
        return [_value(known.get(name)) for name in names]

    def _list(self, request: Any) -> dict[str, Any]:
        """Return the names that begin with one of the prefixes, at any depth."""
        names = [
            name
            for name in self._arm.parameters
            if not request.prefixes
            or any(name == prefix or name.startswith(f"{prefix}.") for prefix in request.prefixes)
        ]
        groups = dict.fromkeys(name.rpartition(".")[0] for name in names)
        return {"result": {"names": names, "prefixes": list(groups)}}

    def _describe(self, request: Any) -> dict[str, Any]:
        values = zip(request.names, self._values(request.names), strict=True)
        return {
            "descriptors": [
                {"name": name, "type": value["type"], "dynamic_typing": True}
                for name, value in values
            ]
        }

    def _set(self, parameters: list[Any]) -> dict[str, Any]:
        """Set parameters together; return a SetParametersResult."""
        values: dict[str, Any] = {}
        for parameter in parameters:
            field = VALUE_FIELDS.get(parameter.value.type)
            if field is None:
                reason = (
                    f"{parameter.name} takes numbers or a text, got type {parameter.value.type}"
                )
                return {"successful": False, "reason": reason}
            value = getattr(parameter.value, field)
            values[parameter.name] = value if not hasattr(value, "tolist") else value.tolist()
        try:
            self._arm.set_parameters(values)
        except PliantError as error:
            return {"successful": False, "reason": str(error)}
        return {"successful": True}


def _value(value: float | list[float] | str | None) -> dict[str, Any]:
    """Return a value as a ParameterValue."""
    if value is None:
        return {"type": NOT_SET}
    kind = TEXT if isinstance(value, str) else DOUBLES if isinstance(value, list) else DOUBLE
    return {"type": kind, VALUE_FIELDS[kind]: value}


def _snake(name: str) -> str:
    """Return "get_parameters" for "GetParameters"."""
    return "".join(f"_{c.lower()}" if c.isupper() else c for c in name).removeprefix("_")
