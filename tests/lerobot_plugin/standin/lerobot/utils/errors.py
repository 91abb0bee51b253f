"""Stand-in for LeRobot's errors."""


class DeviceNotConnectedError(ConnectionError):
    """The device is not connected."""


class DeviceAlreadyConnectedError(ConnectionError):
    """The device is connected already."""
