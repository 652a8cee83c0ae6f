"""Settings of the Keysight 34465A that are kept and read back, and do nothing to a reading of DC voltage.

Programs that set a meter up completely (drivers of measurement frameworks) ask for them all.
"""

from __future__ import annotations

from collections.abc import Callable

#: Header in short form, value after a reset, and what is accepted: words, or a range of numbers.
_SETTINGS: dict[str, tuple[str, tuple[str, ...] | tuple[float, float]]] = {
    "DISP": ("1", ("0", "1", "OFF", "ON")),
    "DISP:STAT": ("1", ("0", "1", "OFF", "ON")),
    "SAMP:COUN:PRET": ("+0", (0.0, 1_999_999.0)),
    "SAMP:SOUR": ("IMM", ("IMM", "TIM")),
    "SAMP:TIM": ("+1.00000000E+00", (0.0, 3600.0)),
    "TRIG:DEL:AUTO": ("1", ("0", "1", "OFF", "ON")),
    "TRIG:LEV": ("+0.00000000E+00", (-1000.0, 1000.0)),
    "TRIG:SLOP": ("NEG", ("NEG", "POS")),
    "VOLT:APER": ("+2.00000000E-01", (2e-5, 1.0)),
    "VOLT:APER:ENAB": ("0", ("0", "1", "OFF", "ON")),
    "VOLT:RES": ("+3.00000000E-06", (0.0, 1.0)),
}
_SHORT = {"IMMEDIATE": "IMM", "TIMER": "TIM", "NEGATIVE": "NEG", "POSITIVE": "POS", "OFF": "0", "ON": "1"}

#: Queries with one answer.
FIXED = {
    "*OPT?": "0,0,DIG,MEM,0",
    "SYST:LIC:CAT?": '"DIG","MEM"',
    "*TST?": "0",
}

MISSING, NOT_A_WORD, OUT_OF_RANGE, NOT_A_NUMBER = -109, -224, -222, -148


class KeptSettings:
    """The settings, by their header.

    Parameters
    ----------
    refuse
        Makes the exception of an error number.
    """

    def __init__(self, refuse: Callable[[int], Exception]) -> None:
        self._refuse = refuse
        self._text = ""
        self.reset()

    def reset(self) -> None:
        """What ``*RST`` does to them."""
        self._values = {header: default for header, (default, _) in _SETTINGS.items()}

    def commands(self) -> dict[str, Callable[[str], str | None]]:
        """Handlers by header: each setting and its query."""
        table: dict[str, Callable[[str], str | None]] = {}
        for header in _SETTINGS:
            table[header] = lambda parameter, header=header: self._set(header, parameter)  # type: ignore[misc]
            table[f"{header}?"] = lambda parameter, header=header: self._get(header, parameter)  # type: ignore[misc]
        for header, answer in FIXED.items():
            table[header] = lambda _, answer=answer: answer  # type: ignore[misc]
        return table | {
            "DISP:TEXT": self._show,
            "DISP:TEXT?": lambda _: f'"{self._text}"',
            "DISP:TEXT:CLE": self._blank,
        }

    def set(self, header: str, value: str) -> None:
        """What another command does to a setting."""
        self._values[header] = value

    def _get(self, header: str, parameter: str) -> str:
        accepted = _SETTINGS[header][1]
        ends = {"MIN": accepted[0], "MAX": accepted[-1]}
        if parameter.upper() in ends and not isinstance(accepted[0], str):
            return f"{ends[parameter.upper()]:+.8E}"
        return self._values[header]

    def _set(self, header: str, parameter: str) -> None:
        default, accepted = _SETTINGS[header]
        word = _SHORT.get(parameter.upper(), parameter.upper())
        if not word:
            raise self._refuse(MISSING)
        if isinstance(accepted[0], str):
            if word not in accepted:
                raise self._refuse(NOT_A_WORD)
            self._values[header] = word
            return
        lower, upper = float(accepted[0]), float(accepted[1])
        try:
            value = float({"MIN": str(lower), "MAX": str(upper), "DEF": default}.get(word, word))
        except ValueError:
            raise self._refuse(NOT_A_NUMBER) from None
        if not lower <= value <= upper:
            raise self._refuse(OUT_OF_RANGE)
        self._values[header] = f"{value:+.8E}"

    def _show(self, text: str) -> None:
        self._text = text.strip("\"'")[:40]

    def _blank(self, _: str) -> None:
        self._text = ""
