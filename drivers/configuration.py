"""``devices.toml``: which device plays which role, on which wire; and connecting them all.

The form is documented by ``docs/devices.example.toml``. A driver is found by its name in the entry-point group
``goniotwin.devices``; a third-party package adds one by naming a class that satisfies :class:`Driver`.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Literal, Protocol, cast

from pydantic import BaseModel, ConfigDict, PositiveFloat

from drivers.clock import Clock
from drivers.errors import CommandRefused, CommunicationError, ConfigurationError, DeviceError, DeviceFault
from drivers.forms import Form, check_form
from drivers.interfaces import OPTIONAL_ROLES, ROLES, Device, Laboratory
from drivers.lines import LineForm, OpenLine
from drivers.misconnection import Survey

GROUP = "goniotwin.devices"


class Driver(Protocol):
    """What an entry point of the group ``goniotwin.devices`` names: usually the driver's class."""

    options: type[Form]
    line_kinds: tuple[str, ...]

    def __call__(self, name: str, line: Any, options: Any, clock: Clock) -> Device:
        """Make the device. Must not speak on the wire: ``identify`` does that."""
        ...


class ClockForm(Form):
    """Laboratory seconds in one second of the wall clock."""

    speed: PositiveFloat = 1.0


class DeviceForm(BaseModel):
    """One device: its driver, its line, and the driver's own options as further keys.

    Attributes
    ----------
    identity
        A part of what the device says of itself (a serial number, a stage's model), where two alike could be swapped.
    """

    model_config = ConfigDict(extra="allow", frozen=True)

    driver: str
    line: str
    identity: str | None = None

    def options(self) -> dict[str, Any]:
        """The keys that belong to the driver."""
        return dict(self.model_extra or {})


class DevicesForm(Form):
    """The whole of ``devices.toml``. ``source`` names the file in errors and is no key of it."""

    version: Literal[1]
    clock: ClockForm = ClockForm()
    lines: dict[str, LineForm]
    devices: dict[str, DeviceForm]

    _source: str = "devices.toml"

    @property
    def source(self) -> str:
        """Name of the file."""
        return self._source


def read_devices(path: Path) -> DevicesForm:
    """Read and check ``devices.toml``, the options of every driver included.

    Raises
    ------
    ConfigurationError
        Naming file and key, what was found and what was expected.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror}; expected a TOML file") from None
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{path}: not a text file ({error.reason} at byte {error.start})") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"{path}: not valid TOML: {error}") from None
    form = parse_devices(data, str(path))
    planned(form)
    return form


def parse_devices(data: Mapping[str, Any], source: str = "devices.toml") -> DevicesForm:
    """Check the form of the file, not yet the options of its drivers."""
    form = check_form(data, DevicesForm, source)
    object.__setattr__(form, "_source", source)
    return form


def endpoints(devices: DevicesForm) -> list[str]:
    """Names of the wires of an instrument, alike in every program that uses them."""
    names = []
    for line in devices.lines.values():
        parts = [str(getattr(line, key)) for key in ("resource", "host", "port") if hasattr(line, key)]
        names.append(":".join(parts))
    return names


@dataclass(frozen=True)
class PlannedDevice:
    """A device that is about to be made: everything but its line is known."""

    role: str
    driver_name: str
    driver: Driver
    line: str
    options: Form


def planned(form: DevicesForm) -> list[PlannedDevice]:
    """Look every driver up and check its options and its line.

    Raises
    ------
    ConfigurationError
        If a role is missing, or a driver, a line or an option is wrong.
    """
    missing = [role for role in ROLES if role not in form.devices]
    if missing:
        raise ConfigurationError(f"{form.source}: devices.{missing[0]}: missing (roles without device: {missing})")
    plans = [_plan(form, role, device) for role, device in form.devices.items()]
    _require_apart(form, plans)
    return plans


def _require_apart(form: DevicesForm, plans: list[PlannedDevice]) -> None:
    """No two devices at one address, no two lines on one port."""
    taken: dict[tuple[str, str, str], str] = {}
    for plan in plans:
        for unit, part in plan.options.claims():
            for (line, other, portion), role in taken.items():
                if (line, other) == (plan.line, unit) and (not part or not portion or part == portion):
                    what = f"{unit}, {part}" if part else unit
                    raise ConfigurationError(
                        f"{form.source}: devices.{plan.role}: {what} on line {plan.line!r} is that of"
                        f" devices.{role} already"
                    )
        taken |= {(plan.line, unit, part): plan.role for unit, part in plan.options.claims()}
    ports: dict[str, str] = {}
    for name, wire in form.lines.items():
        port = str(getattr(wire, "port", "")) if wire.kind in ("serial", "modbus-serial") else ""
        if port and (first := ports.setdefault(os.path.realpath(port), name)) != name:
            raise ConfigurationError(f"{form.source}: lines.{name}.port: {port} is that of lines.{first} already")


def _plan(form: DevicesForm, role: str, device: DeviceForm) -> PlannedDevice:
    key = f"{form.source}: devices.{role}"
    points = installed_drivers()
    if device.driver not in points:
        raise ConfigurationError(f"{key}.driver: found {device.driver!r}; expected one of {sorted(points)}")
    driver = cast(Driver, points[device.driver].load())
    if device.line not in form.lines:
        raise ConfigurationError(f"{key}.line: found {device.line!r}; expected one of {sorted(form.lines)}")
    kind = form.lines[device.line].kind
    if kind not in driver.line_kinds:
        expected = " or ".join(driver.line_kinds)
        raise ConfigurationError(f"{key}.line: {device.line!r} is of kind {kind!r}; {device.driver} needs {expected}")
    options = check_form(device.options(), driver.options, form.source, ("devices", role))
    return PlannedDevice(role, device.driver, driver, device.line, options)


def installed_drivers() -> dict[str, EntryPoint]:
    """Entry points of every installed driver, by name."""
    return {point.name: point for point in entry_points(group=GROUP)}


@dataclass
class Connection:
    """Open lines and the devices on them; closes everything it holds."""

    lines: dict[str, OpenLine] = field(default_factory=dict)
    devices: dict[str, Device] = field(default_factory=dict)

    def close(self) -> None:
        """Release every device, then every line."""
        for device in self.devices.values():
            device.close()
        for line in self.lines.values():
            line.close()


def make_devices(
    form: DevicesForm, clock: Clock, failed: Callable[[PlannedDevice, Exception], None] | None = None
) -> Connection:
    """Open the lines and make every device, without speaking to any.

    Parameters
    ----------
    form
        The checked file.
    clock
        Laboratory time.
    failed
        Called for a device that could not be made, which is then left out; without it the first failure is
        raised and everything that was opened is closed.

    Raises
    ------
    DeviceError, ConfigurationError
        Naming the device and its line.
    """
    connection = Connection()
    try:
        for plan in planned(form):
            try:
                device = _make(plan, form, clock, connection.lines)
            except (DeviceError, ConfigurationError) as error:
                if failed is None:
                    raise
                failed(plan, error)
            else:
                connection.devices[plan.role] = device
    except BaseException:
        connection.close()
        raise
    return connection


def _make(plan: PlannedDevice, form: DevicesForm, clock: Clock, lines: dict[str, OpenLine]) -> Device:
    if plan.line not in lines:
        lines[plan.line] = _open(plan, form)
    device = plan.driver(plan.role, lines[plan.line], plan.options, clock)
    wanted = (ROLES | OPTIONAL_ROLES).get(plan.role, Device)
    if not isinstance(device, wanted):
        raise ConfigurationError(
            f"{form.source}: devices.{plan.role}.driver: {plan.driver_name!r} is no {wanted.__name__}, "
            f"which the role {plan.role!r} needs"
        )
    return device


def _open(plan: PlannedDevice, form: DevicesForm) -> OpenLine:
    try:
        return form.lines[plan.line].open(plan.line)
    except ValueError as error:
        # What a port's library says of a value that no port can have: an unknown URL, an impossible baud rate.
        raise ConfigurationError(f"{form.source}: lines.{plan.line}: {error}") from error
    except OSError as error:
        raise CommunicationError(
            plan.role,
            f"line {plan.line!r} cannot be opened: {error}",
            f"check lines.{plan.line} of {form.source} and the cable",
        ) from error


def connect(form_or_path: DevicesForm | Path, clock: Clock | None = None) -> Laboratory:
    """Open every line, make every device and ask each who it is.

    Parameters
    ----------
    form_or_path
        ``devices.toml``, read or not.
    clock
        Laboratory time; made from the file's ``clock.speed`` where it is not given.

    Returns
    -------
    Laboratory
        Every device answered; nothing has moved.

    Raises
    ------
    ConfigurationError
        If the file is wrong.
    DeviceError
        If a line cannot be opened or a device does not answer as expected; names both. Everything that was
        opened is closed again.
    """
    form = form_or_path if isinstance(form_or_path, DevicesForm) else read_devices(Path(form_or_path))
    connection = make_devices(form, clock or Clock(form.clock.speed))
    try:
        for role, device in connection.devices.items():
            _identify(role, device, form, connection)
    except BaseException:
        connection.close()
        raise
    others = {role: device for role, device in connection.devices.items() if role not in ROLES}
    roles: dict[str, Any] = {role: connection.devices[role] for role in ROLES}
    return Laboratory(**roles, others=others)


def identified(role: str, device: Device, entry: DeviceForm) -> str:
    """What a device says of itself.

    Raises
    ------
    CommandRefused
        If that lacks ``identity``.
    DeviceError
        From the device.
    """
    found = device.identify()
    if entry.identity is not None and entry.identity not in found:
        raise CommandRefused(
            role,
            f"devices.{role}.identity: expected {entry.identity!r}; answered: {found}",
            "addresses or cables may be swapped",
        )
    return found


def _identify(role: str, device: Device, form: DevicesForm, connection: Connection) -> str:
    entry = form.devices[role]
    try:
        return identified(role, device, entry)
    except DeviceError as error:
        advice = error.advice
        if not isinstance(error, DeviceFault):  # a fault is the device's own: it is the one that was meant
            connection.close()  # the wires have to be free for a look at who answers
            advice = Survey(form).explain(role) or advice
        raise type(error)(role, f"on line {entry.line!r}, driver {entry.driver!r}: {error.problem}", advice) from error
