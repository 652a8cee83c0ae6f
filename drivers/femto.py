"""FEMTO transimpedance amplifiers: gain bits on the outputs of a Modbus I/O module, overload line on an input.

Codes of the DLPCA-200 are ``mode << 3 | G3 << 2 | G2 << 1 | G1``: mode 0 (high speed) gives 1e5 to 1e11 V/A for codes
0 to 6, mode 1 (low noise) 1e3 to 1e9 for codes 8 to 14; 7 and 15 are invalid. The DDPCA-300 has codes 0 to 9 for 1e4
to 1e13 V/A. Calibrated gains replace the nominal ones in ``devices.toml``.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, PositiveFloat, model_validator

from drivers.clock import Clock
from drivers.errors import CommandRefused, DeviceFault
from drivers.forms import Form
from drivers.modbus_io import Channel, ModbusIo, SlaveAddress, io_claims
from drivers.modbus_line import ModbusLine

#: Code and nominal gain in V/A by model and mode.
NOMINAL: dict[tuple[str, str], dict[int, float]] = {
    ("dlpca-200", "high-speed"): {code: 10.0 ** (5 + code) for code in range(7)},
    ("dlpca-200", "low-noise"): {8 + code: 10.0 ** (3 + code) for code in range(7)},
    ("ddpca-300", "low-noise"): {code: 10.0 ** (4 + code) for code in range(10)},
}


class FemtoForm(Form):
    """Options of the amplifier in ``devices.toml``.

    Attributes
    ----------
    address
        Slave number of the module.
    model, mode
        Which table of codes applies; ``custom`` has none and needs ``codes`` and ``gains``.
    coils
        Outputs of the code's bits, lowest bit first.
    codes
        The settings in use; all of the table where it is not given.
    gains
        V/A of each code: calibrated values in place of the nominal ones.
    coupling_coil
        Output that selects DC coupling; None where it is not wired.
    overload_input
        Input that is 1 during an overload; None where it is not wired.
    settling_time
        Laboratory s after a change of gain.
    """

    address: SlaveAddress = 1
    model: Literal["dlpca-200", "ddpca-300", "custom"] = "dlpca-200"
    mode: Literal["low-noise", "high-speed"] = "low-noise"
    coils: Annotated[tuple[Channel, ...], Field(min_length=1, max_length=8)]
    codes: tuple[Annotated[int, Field(ge=0, le=255)], ...] | None = None
    gains: tuple[PositiveFloat, ...] | None = None
    coupling_coil: Channel | None = None
    overload_input: Channel | None = None
    settling_time: Annotated[float, Field(ge=0, le=60)] = 0.3

    def claims(self) -> list[tuple[str, str]]:
        """The outputs of the bits and of the coupling, and the input of the overload line."""
        coupling = [] if self.coupling_coil is None else [self.coupling_coil]
        inputs = [] if self.overload_input is None else [self.overload_input]
        return io_claims(self.address, [*self.coils, *coupling], inputs)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(set(self.coils)) != len(self.coils):
            raise ValueError("coils name one output twice")
        if self.coupling_coil in self.coils:
            raise ValueError("coupling_coil is one of coils")
        if self.model == "custom" and (self.codes is None or self.gains is None):
            raise ValueError("model 'custom' needs codes and gains")
        if self.model == "ddpca-300" and self.mode != "low-noise":
            raise ValueError("model 'ddpca-300' has no mode")
        table = self._nominal()
        unknown = [code for code in self.codes or () if self.model != "custom" and code not in table]
        if unknown:
            raise ValueError(f"codes {unknown} do not exist in mode {self.mode!r}; expected some of {sorted(table)}")
        if self.gains is not None and len(self.gains) != len(self.codes or table):
            raise ValueError(f"{len(self.gains)} gains for {len(self.codes or table)} codes")
        settings = self.settings()
        if list(settings.values()) != sorted(set(settings.values())):
            raise ValueError("gains must ascend, one a code")
        if max(settings, default=0) >= 1 << len(self.coils):
            raise ValueError(f"code {max(settings)} needs more than {len(self.coils)} coils")
        return self

    def _nominal(self) -> dict[int, float]:
        return NOMINAL.get((self.model, self.mode), {})

    def settings(self) -> dict[int, float]:
        """Code and gain in V/A of every setting in use."""
        table = self._nominal()
        codes = self.codes or tuple(table)
        gains = self.gains or tuple(table[code] for code in codes)
        return dict(zip(codes, gains, strict=True))


class Femto:
    """The amplifier. Satisfies :class:`drivers.interfaces.Amplifier`."""

    options = FemtoForm
    line_kinds = ("modbus-serial", "modbus-tcp")

    def __init__(self, name: str, line: ModbusLine, options: FemtoForm, clock: Clock) -> None:
        self.name = name
        self.settling_time = options.settling_time
        self._settings = options.settings()
        self.gains: tuple[float, ...] = tuple(self._settings.values())
        self._line, self._options = line, options
        self._io = ModbusIo(name, line, options.address)
        line.attach(name)

    def identify(self) -> str:
        """State of the module that drives the gain bits; selects DC coupling where it is wired."""
        if self._options.coupling_coil is not None:
            self._io.set_output(self._options.coupling_coil, True)
        lowest, highest = self.gains[0], self.gains[-1]
        return f"FEMTO {self._options.model}, {lowest:.3g} to {highest:.3g} V/A; {self._io.identify()}"

    def gain(self) -> float:
        """Gain in use, V/A, by the outputs read back.

        Raises
        ------
        DeviceFault
            If the outputs hold a code that is not in use.
        """
        outputs = self._io.outputs()
        code = sum(outputs[coil] << bit for bit, coil in enumerate(self._options.coils))
        if code not in self._settings:
            raise DeviceFault(
                self.name, f"the gain bits hold code {code}, expected one of {list(self._settings)}", "set a gain"
            )
        return self._settings[code]

    def set_gain(self, gain: float) -> None:
        """Select one of ``gains``; all bits change in one frame where the outputs are neighbours.

        Raises
        ------
        CommandRefused
            If there is no such gain.
        DeviceFault
            If the outputs do not read back.
        """
        code = next((c for c, value in self._settings.items() if math.isclose(value, gain, rel_tol=1e-9)), None)
        if code is None:
            known = ", ".join(f"{value:g}" for value in self.gains)
            raise CommandRefused(self.name, f"there is no gain of {gain:g} V/A; expected one of {known}")
        self._io.set_outputs({coil: bool(code >> bit & 1) for bit, coil in enumerate(self._options.coils)})

    def overload(self) -> bool:
        """State of the overload line; False where it is not wired."""
        if self._options.overload_input is None:
            return False
        return self._io.inputs()[self._options.overload_input]

    def make_safe(self) -> None:
        """Nothing to do: no gain is dangerous."""

    def close(self) -> None:
        """Release the wire."""
        self._line.release(self.name)
