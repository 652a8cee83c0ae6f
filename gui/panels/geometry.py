"""Where the arms are, and what the last reading said."""

from __future__ import annotations

from PySide6.QtWidgets import QGridLayout, QLabel, QWidget

from gui import marks, words
from gui.model import Changes, ScanModel, noise_of
from gui.panels.base import Panel, quiet, value
from gui.points import plane_of
from gui.theme import Theme

_FLAGS = {1: "saturated", 2: "overload", 4: "shadowed", 8: "repeated"}  # CF flags of the run file
_ELECTRIC = ("Gain", "Scatter of samples", "Dark level", "Taken")


class GeometryPanel(Panel):
    """Current geometry and last reading."""

    area = "acquire"
    order = 1
    title = "Current geometry and last reading"

    def __init__(self, model: ScanModel, theme: Theme, parent: QWidget | None = None) -> None:
        super().__init__(model, theme, parent)
        self.rows: dict[str, QLabel] = {}
        grid = QGridLayout()
        grid.setVerticalSpacing(3)
        names = (
            "Wavelength",
            "Illumination zenith",
            "Sensor azimuth",
            "Sensor zenith",
            "Reference",
            "Last measured",
            "Simulated",
            "Difference t′",
            "Gain",
            "Scatter of samples",
            "Dark level",
            "Taken",
        )
        for row, name in enumerate(names):
            self.rows[name] = value("–")
            grid.addWidget(quiet(name), row, 0)
            grid.addWidget(self.rows[name], row, 2)
        self.sign = QLabel()
        self.sign.setFixedWidth(18)
        grid.addWidget(self.sign, names.index("Difference t′"), 1)
        grid.setColumnStretch(2, 1)
        self.body.addLayout(grid)
        self.refresh(Changes(scan=True))

    def refresh(self, changes: Changes) -> None:
        """Show geometry, reference and last reading."""
        if not (changes.current or changes.scan or changes.planes):
            return
        model = self.model
        geometry = model.points[model.current].geometry if model.current is not None else None
        self._set("Wavelength", f"{geometry.wavelength:g} nm" if geometry else "–")
        self._set("Illumination zenith", words.angle(geometry.illumination_zenith) if geometry else "–")
        self._set("Sensor azimuth", words.angle(geometry.sensor_azimuth) if geometry else "–")
        self._set("Sensor zenith", words.angle(geometry.sensor_zenith) if geometry else "–")
        if model.references:
            reference = model.references[-1]
            count = len(model.references)
            self._set("Reference", f"{words.current(reference.current)} ({count} reading{'s' if count > 1 else ''})")
        else:
            self._set("Reference", "–")
        self._show_last()

    def _show_last(self) -> None:
        last = self.model.last
        point = self.model.points[last.index] if last else None
        if last is None or point is None:
            for name in ("Last measured", "Simulated", "Difference t′", *_ELECTRIC):
                self._set(name, "–")
            self.sign.clear()
            return
        flags = [name for bit, name in _FLAGS.items() if last.quality_flag & bit]
        self._set("Last measured", f"{words.number(last.brf)} ± {words.number(last.u_brf)} {' '.join(flags)}".strip())
        self.rows["Last measured"].setToolTip(
            f"{words.plane_title(plane_of(last.geometry))}, {words.point_values(point)}\n"
            f"{len(last.signal)} samples, gain {last.gain:.0e} V/A, dark {last.dark * 1e3:.3f} mV"
        )
        self._set("Gain", words.gain(last.gain))
        noise = noise_of(last.signal)
        self._set("Scatter of samples", f"{100 * noise:.2g} % ({len(last.signal)} samples)")
        self._set("Dark level", f"{last.dark * 1e3:.3g} mV".replace("-", words.MINUS))
        self._set("Taken", f"{words.clock_time(last.time)} UTC")
        waiting = "no prediction yet" if point.simulated is None else ""
        self._set(
            "Simulated",
            waiting or f"{words.number(point.simulated or 0.0)} ± {words.number(point.u_simulated or 0.0)}",
        )
        if point.score is None:
            self._set("Difference t′", "–")
            self.sign.clear()
            return
        category = point.score.category
        self._set("Difference t′", f"{words.number(point.score.t, 2)}  {category}")
        self.sign.setPixmap(marks.pixmap(marks.CATEGORY_SIGN[category], getattr(self.theme, category), 14))

    def _set(self, name: str, text: str) -> None:
        self.rows[name].setText(text)


PANEL = GeometryPanel
