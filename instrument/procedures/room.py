"""The instrument as a procedure has it: the devices of a scan, and the same safe end however it comes."""

from __future__ import annotations

import signal
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from drivers.clock import Clock
from drivers.configuration import connect, endpoints, read_devices
from drivers.interfaces import Laboratory
from drivers.lock import InstrumentLock
from instrument.control import Controls, ask, ensure
from instrument.errors import InputError, SafetyError
from instrument.events import Geometry
from instrument.facility import Facility, read_facility
from instrument.laboratories import StartedLaboratory, laboratory_factory
from instrument.procedures.people import Rehearsal
from instrument.procedures.results import RESULTS
from instrument.prompts import START_SOURCE, Answer, Guide, Prompt, attend
from instrument.settings import ScanSettings
from instrument.station import Station, each

_WORDS = {
    "reference": ("Put the reference standard on the stage", "Its surface lies in the plane of the arms' axes."),
    "control_sample": ("Put the control sample on the stage", "In the orientation of its mark, as always."),
    "wavelength_standard": ("Put the wavelength standard on the stage", "Its surface lies in the plane of the axes."),
    "edge_target": (
        "Put the edge target on the stage",
        "Half white, half black, the edge through the optical centre across the plane of incidence; white towards x.",
    ),
}


@dataclass(frozen=True)
class RoomRequest:
    """What a procedure works with; see :class:`instrument.request.ScanRequest`.

    Attributes
    ----------
    results
        Folder of the results.
    who
        Who does it; the account by default.
    """

    simulate: bool = False
    speed: float = 1.0
    seed: int = 1
    devices: Path | None = None
    facility: Path | None = None
    results: Path = RESULTS
    who: str | None = None

    def check(self) -> None:
        """Refuse options that do not go together.

        Raises
        ------
        InputError
        """
        if self.simulate and self.devices is not None:
            raise InputError("--simulate and --devices exclude each other")
        if not self.simulate and (self.devices is None or self.facility is None):
            raise InputError("nothing to measure with; expected --simulate, or --devices and --facility")


@dataclass
class Room:
    """A connected instrument.

    Attributes
    ----------
    say
        Tells the person at the terminal how far it is.
    files
        Folder with further files of the laboratory (certificates of the simulated one); None where there is none.
    """

    station: Station
    controls: Controls
    clock: Clock
    facility: Facility
    operator: object
    settings: ScanSettings
    notes: list[str]
    request: RoomRequest
    files: Path | None = None
    answers: list[Answer] = field(default_factory=list)
    say: Any = lambda text: None
    mounted: str = ""
    _confirmed: bool = False

    @property
    def laboratory(self) -> Laboratory:
        """The devices."""
        return self.station.laboratory

    def ask(self, prompt: Prompt) -> Answer:
        """Have a person do a step; the answer is kept."""
        answer = attend(self.operator, prompt, self.controls, now=self.clock.now(), who=self.request.who)
        self.answers.append(answer)
        return answer

    def mount(self, what: str) -> None:
        """Have something put on the stage: arms at rest, shutter closed, source off."""
        if self.mounted == what:
            return
        self.station.rest()
        self.station.light.off()
        title, text = _WORDS.get(what, (f"Put the {what.replace('_', ' ')} on the stage", ""))
        self.ask(Prompt(key=f"mount:{what}", title=title, text=text))
        self.mounted = what

    def light(self) -> None:
        """Switch the source on; the first time a person confirms that it may."""
        if self.station.light.wanted:
            return
        if not self._confirmed:
            self.ask(START_SOURCE)
            self._confirmed = True
        self.station.light.on()
        self.controls.sleep(self.settings.warm_up)

    def home(self) -> None:
        """Find the zero of the arms that do not know it."""
        for axis in self.laboratory.axes():
            self.station.mover.home(axis)

    def go(self, illumination: float, zenith: float, azimuth: float, wavelength: float) -> Geometry:
        """Bring arms and filter to a geometry (degree, nm)."""
        geometry = Geometry(
            wavelength=wavelength, illumination_zenith=illumination, sensor_zenith=zenith, sensor_azimuth=azimuth
        )
        self.station.go(geometry)
        return geometry

    def go_to_reference(self, wavelength: float) -> Geometry:
        """The first geometry of the reference reading."""
        known = self.facility.reference
        return self.go(known.illumination_zenith, known.sensor_zenith, known.sensor_azimuth[0], wavelength)

    @contextmanager
    def beam(self) -> Iterator[None]:
        """Let light onto the stage for a person's eyes; the shutter is closed afterwards, whatever happens."""
        shutter = self.laboratory.shutter
        ensure(shutter.open, lambda: ask(shutter.is_open), "shutter")
        try:
            yield
        finally:
            self.station.acquisition.shut()

    def identities(self) -> dict[str, Any]:
        """What the instrument is, for the record."""
        devices = {name: ask(device.identify) for name, device in self.laboratory.devices().items()}
        return {"facility": self.facility.name, "simulated": self.request.simulate, "devices": devices}


@contextmanager
def open_room(
    request: RoomRequest,
    operator: object | None = None,
    settings: ScanSettings | None = None,
    laboratory: StartedLaboratory | None = None,
    rehearsing: Guide | None = None,
) -> Iterator[Room]:
    """Connect, and end in the safe state: emission off, shutter closed, arms at rest.

    Parameters
    ----------
    operator
        Who answers prompts; the simulated laboratory brings its own.
    laboratory
        One that runs already, in place of starting the simulated one.
    rehearsing
        A person who is asked before the simulated laboratory's own operator does what a prompt says.

    Raises
    ------
    InputError, ConfigurationError, DeviceError
        Before anything moves.
    SafetyError
        If the safe state could not be reached at the end.
    """
    request.check()
    settings = settings or ScanSettings()
    with ExitStack() as stack:
        if request.simulate and laboratory is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="goniotwin-")))
            factory = laboratory_factory()
            laboratory = stack.enter_context(
                factory(folder, speed=request.speed, seed=request.seed, facility=request.facility)
            )
        devices_path, facility_path = request.devices, request.facility
        if laboratory is not None:
            devices_path, facility_path = laboratory.inputs.devices, laboratory.inputs.facility
            operator = operator or laboratory.operator
            operator = Rehearsal(rehearsing, operator) if rehearsing is not None else operator
        assert devices_path is not None
        assert facility_path is not None
        facility, form = read_facility(facility_path), read_devices(devices_path)
        clock = Clock(form.clock.speed)
        stack.enter_context(InstrumentLock(endpoints(form)))
        controls = Controls(clock)
        stack.enter_context(_interrupts(controls))
        devices = connect(form, clock)
        notes: list[str] = []
        station = Station(devices, facility.arms, clock, controls, settings, notes.append, notes.append)
        room = Room(station, controls, clock, facility, operator, settings, notes, request, devices_path.parent)
        try:
            station.acquisition.shut()
            yield room
        finally:
            problems = station.make_safe() + each(device.close for device in devices.devices().values())
        if problems:
            raise SafetyError(f"not brought into its safe state: {problems[0]}; look at the instrument")


@contextmanager
def _interrupts(controls: Controls) -> Iterator[None]:
    """Ctrl-C and a request to terminate end a procedure in an orderly way; Ctrl-\\ (SIGQUIT) is its emergency stop."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, frame: FrameType | None) -> None:
        if number == signal.SIGQUIT:
            controls.halt("emergency stop")
        else:
            controls.abort("interrupted at the terminal")

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
    before = {number: signal.signal(number, end) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
