"""What can go wrong with a device. Every error says which device, what happened and what to do."""

from __future__ import annotations


class DeviceError(Exception):
    """A device did not do what it was asked.

    Parameters
    ----------
    device
        Name of the device as the laboratory knows it (``sensor_zenith``).
    problem
        What happened, in words.
    advice
        What a person can do about it.
    """

    def __init__(self, device: str, problem: str, advice: str = "") -> None:
        self.device, self.problem, self.advice = device, problem, advice
        super().__init__(f"{device}: {problem}" + (f" ({advice})" if advice else ""))


class CommunicationError(DeviceError):
    """No reply, a late one, or one that cannot be understood: the state of the device is not known."""


class DeviceFault(DeviceError):
    """The device itself reports a fault: an alarm, a limit, an overload, an open interlock."""


class CommandRefused(DeviceError):
    """The device understood the command and refused it; nothing has moved."""


class ConfigurationError(Exception):
    """``devices.toml`` is wrong; the message names file and key, what was found and what was expected."""
