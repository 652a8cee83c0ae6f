"""Asking every device who it is and how it is, one failure leaving the others to be tried."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

from rich.table import Table
from rich.text import Text

from drivers.clock import Clock
from drivers.configuration import DeviceForm, DevicesForm, PlannedDevice, identified, make_devices
from drivers.errors import ConfigurationError, DeviceError, DeviceFault
from drivers.interfaces import Amplifier, Axis, Detector, Device, LightSource, Shutter, WavelengthSelector
from drivers.misconnection import Survey


@dataclass(frozen=True)
class CheckResult:
    """What one device answered.

    Attributes
    ----------
    role, driver, line
        As in ``devices.toml``.
    identity
        Who it says it is.
    state
        How it is, in words.
    problem
        Why the check failed; empty where it did not.
    cause
        Where the file and the wires disagree: line of the file, what was expected, what answered.
    """

    role: str
    driver: str
    line: str
    identity: str = ""
    state: str = ""
    problem: str = ""
    cause: str = ""

    @property
    def ok(self) -> bool:
        """True where the device answered and reports no fault."""
        return not self.problem

    def as_dict(self) -> dict[str, str | bool]:
        """The result for programs."""
        return asdict(self) | {"ok": self.ok}


def check_devices(form: DevicesForm, clock: Clock | None = None) -> list[CheckResult]:
    """Try every device of the file; nothing moves and every line is closed again.

    Raises
    ------
    ConfigurationError
        If the file is wrong.
    """
    failures: dict[str, str] = {}

    def failed(plan: PlannedDevice, error: Exception) -> None:
        if isinstance(error, ConfigurationError):
            raise error
        failures[plan.role] = error.problem if isinstance(error, DeviceError) else str(error)

    connection = make_devices(form, clock or Clock(form.clock.speed), failed)
    try:
        results = [
            _check(role, entry, connection.devices.get(role), failures.get(role, ""))
            for role, entry in form.devices.items()
        ]
    finally:
        connection.close()
    survey = Survey(form)
    # A device that has said who it is stands where the file says; what it complains of is its own affair.
    return [_explained(result, survey) for result in results]


def _explained(result: CheckResult, survey: Survey) -> CheckResult:
    """With the reason of a silence, and with what a device cannot know: that another one answers beside it."""
    if not result.ok:
        return result if result.identity else replace(result, cause=survey.explain(result.role))
    cause = survey.crowd(result.role)
    return replace(result, problem="another device answers at this address", cause=cause) if cause else result


def _check(role: str, entry: DeviceForm, device: Device | None, problem: str) -> CheckResult:
    driver, line = entry.driver, entry.line
    if device is None:
        return CheckResult(role, driver, line, problem=problem)
    identity = ""
    try:
        identity = identified(role, device, entry)
        state, fault = describe(device)
    except DeviceError as error:
        advice = f" ({error.advice})" if error.advice else ""
        known = identity or ("not said" if isinstance(error, DeviceFault) else "")
        return CheckResult(role, driver, line, known, problem=error.problem + advice)
    return CheckResult(role, driver, line, identity, state, fault)


def describe(device: Device) -> tuple[str, str]:
    """State and fault of a device, in words."""
    if isinstance(device, Axis):
        status = device.status()
        words = [f"{device.position():.3f} degree", "moving" if status.moving else "standing"]
        return ", ".join([*words, "homed" if status.homed else "not homed"]), status.fault
    if isinstance(device, LightSource):
        return f"emission {'on' if device.emission() else 'off'}, power {device.power():.1%}", device.fault()
    if isinstance(device, WavelengthSelector):
        # A filter need not know of faults; where it does, they belong here.
        fault = getattr(device, "fault", None)
        return f"{device.wavelength():g} nm", fault() if fault is not None else ""
    if isinstance(device, Amplifier):
        return _gain(device), "overload" if device.overload() else ""
    if isinstance(device, Shutter):
        return "open" if device.is_open() else "closed", ""
    if isinstance(device, Detector):
        return f"{device.read(1).samples[0]:.6g} V", ""
    return "", ""


def _gain(amplifier: Amplifier) -> str:
    try:
        return f"{amplifier.gain():.4g} V/A"
    except DeviceFault as error:
        return error.problem  # after power-up no gain is selected yet, which is no failure of the connection


def causes(results: list[CheckResult]) -> list[Text]:
    """Where the file and the wires disagree, one line a device: too long for a column, and to be copied whole."""
    return [Text(f"{result.role}: {result.cause}", style="bold red") for result in results if result.cause]


def table(results: list[CheckResult]) -> Table:
    """The results for the terminal."""
    shown = Table(title="Devices")
    for heading in ("role", "line", "identity", "state", "check"):
        shown.add_column(heading, overflow="fold")
    for result in results:
        words = "does not answer as expected: see below" if result.cause else result.problem
        verdict = Text("ok", style="green") if result.ok else Text(words, style="bold red")
        shown.add_row(result.role, result.line, Text(result.identity), Text(result.state), verdict)
    return shown
