"""Light and dark palettes, and the colours of what is plotted.

The data colours are those of Okabe and Ito (2008), told apart by people with any of the common colour visions; every
one of them goes with a shape, a line style or a word as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from PySide6.QtCore import QSettings, Qt
from PySide6.QtGui import QColor, QFont, QFontDatabase, QGuiApplication, QPalette
from PySide6.QtWidgets import QApplication

Choice = Literal["system", "light", "dark"]


@dataclass(frozen=True)
class Theme:
    """Colours by what they mean; strings that :class:`QColor` reads."""

    dark: bool
    window: str
    surface: str
    raised: str
    line: str
    text: str
    quiet_text: str
    accent: str
    on_accent: str
    measured: str
    simulated: str
    good: str
    acceptable: str
    poor: str
    band_inner: str
    band_outer: str
    busy: str
    hold: str
    bad: str
    halt: str
    tone_surface: dict[str, str]

    def tone(self, tone: str) -> str:
        """Colour of a state's tone."""
        colours = {"busy": self.busy, "hold": self.hold, "good": self.good, "bad": self.bad}
        return colours.get(tone, self.quiet_text)


LIGHT = Theme(
    dark=False,
    window="#eef1f4",
    surface="#ffffff",
    raised="#f7f9fa",
    line="#d3d9df",
    text="#1b232b",
    quiet_text="#566370",
    accent="#005a9c",
    on_accent="#ffffff",
    measured="#005a9c",
    simulated="#c75000",
    good="#00795a",
    acceptable="#9a6700",
    poor="#b3261e",
    band_inner="#cfe3dc",
    band_outer="#f4ead0",
    busy="#005a9c",
    hold="#9a6700",
    bad="#b3261e",
    halt="#c62828",
    tone_surface={
        "quiet": "#f7f9fa",
        "busy": "#e3eef7",
        "hold": "#fbf1dc",
        "good": "#dff1ea",
        "bad": "#fae2e0",
    },
)
DARK = Theme(
    dark=True,
    window="#14181c",
    surface="#1c2227",
    raised="#242b31",
    line="#38424b",
    text="#e8edf1",
    quiet_text="#a3b0bb",
    accent="#56b4e9",
    on_accent="#0c1318",
    measured="#56b4e9",
    simulated="#ff9d4d",
    good="#3fc79a",
    acceptable="#f0c14b",
    poor="#ff7d70",
    band_inner="#203c36",
    band_outer="#3a3423",
    busy="#56b4e9",
    hold="#f0c14b",
    bad="#ff7d70",
    halt="#c62828",
    tone_surface={
        "quiet": "#242b31",
        "busy": "#183040",
        "hold": "#3a3220",
        "good": "#17382e",
        "bad": "#452421",
    },
)


def choose(choice: Choice) -> Theme:
    """Use a light or dark palette, or what the desktop says; returns the theme."""
    application = QApplication.instance()
    assert isinstance(application, QApplication)
    hints = QGuiApplication.styleHints()
    scheme = {"system": Qt.ColorScheme.Unknown, "light": Qt.ColorScheme.Light, "dark": Qt.ColorScheme.Dark}[choice]
    hints.setColorScheme(scheme)
    dark = choice == "dark" or (choice == "system" and hints.colorScheme() is Qt.ColorScheme.Dark)
    theme = DARK if dark else LIGHT
    application.setPalette(_palette(theme))
    application.setStyleSheet(_style_sheet(theme))
    return theme


def remembered(settings: QSettings) -> Choice:
    """The palette chosen last; the desktop's where none was."""
    value = settings.value("palette", "system")
    return value if value in ("light", "dark") else "system"


def ensure_fonts() -> None:
    """On a machine without any font, use the ones that come with matplotlib: text must be legible everywhere."""
    if QFontDatabase.families():
        return
    from importlib.util import find_spec
    from pathlib import Path

    spec = find_spec("matplotlib")
    if spec is None or spec.origin is None:
        return
    folder = Path(spec.origin).parent / "mpl-data" / "fonts" / "ttf"
    for name in ("DejaVuSans.ttf", "DejaVuSans-Bold.ttf", "DejaVuSansMono.ttf"):
        QFontDatabase.addApplicationFont(str(folder / name))
    QApplication.setFont(QFont("DejaVu Sans", 10))


def _palette(theme: Theme) -> QPalette:
    role = QPalette.ColorRole
    colours = {
        role.Window: theme.window,
        role.WindowText: theme.text,
        role.Base: theme.surface,
        role.AlternateBase: theme.raised,
        role.Text: theme.text,
        role.Button: theme.raised,
        role.ButtonText: theme.text,
        role.ToolTipBase: theme.raised,
        role.ToolTipText: theme.text,
        role.PlaceholderText: theme.quiet_text,
        role.Highlight: theme.accent,
        role.HighlightedText: theme.on_accent,
        role.Link: theme.accent,
        role.Mid: theme.line,
    }
    palette = QPalette()
    for each, colour in colours.items():
        palette.setColor(each, QColor(colour))
    for each in (role.WindowText, role.Text, role.ButtonText):
        palette.setColor(QPalette.ColorGroup.Disabled, each, QColor(theme.quiet_text))
    return palette


def _style_sheet(theme: Theme) -> str:
    return f"""
    QFrame#card {{ background: {theme.surface}; border: 1px solid {theme.line}; border-radius: 8px; }}
    QLabel#cardTitle {{ color: {theme.quiet_text}; font-weight: 600; }}
    QLabel[role="quiet"] {{ color: {theme.quiet_text}; }}
    QLabel[role="value"] {{ font-weight: 600; }}
    QPushButton {{ background: {theme.raised}; border: 1px solid {theme.line}; border-radius: 6px; padding: 6px 12px; }}
    QPushButton:hover:enabled {{ border-color: {theme.accent}; }}
    QPushButton:focus {{ border: 2px solid {theme.accent}; padding: 5px 11px; }}
    QPushButton:disabled {{ color: {theme.quiet_text}; background: {theme.window}; border-style: dashed; }}
    QPushButton#start:enabled {{ background: {theme.accent}; color: {theme.on_accent}; font-weight: 600; }}
    QPushButton#halt:enabled {{ background: {theme.halt}; color: #ffffff; font-weight: 700; }}
    QProgressBar {{ background: {theme.raised}; border: 1px solid {theme.line}; border-radius: 5px;
                    max-height: 10px; }}
    QProgressBar::chunk {{ background: {theme.busy}; border-radius: 4px; }}
    QTableView, QListView {{ border: none; background: {theme.surface}; gridline-color: {theme.line};
                             selection-background-color: {theme.tone_surface["busy"]};
                             selection-color: {theme.text}; }}
    QHeaderView {{ background: {theme.surface}; }}
    QHeaderView::section {{ background: {theme.surface}; color: {theme.quiet_text}; border: none;
                            border-bottom: 1px solid {theme.line}; padding: 4px 3px; }}
    QSplitter::handle {{ background: {theme.window}; }}
    QToolButton#navigation {{ background: transparent; border: 1px solid transparent; border-radius: 8px;
                              padding: 6px 4px; }}
    QToolButton#navigation:hover {{ border-color: {theme.line}; }}
    QToolButton#navigation:checked {{ background: {theme.surface}; border-color: {theme.line};
                                      border-left: 4px solid {theme.accent}; font-weight: 600; }}
    QToolButton#navigation:focus {{ border-color: {theme.accent}; }}
    QScrollArea, QScrollArea > QWidget > QWidget {{ background: transparent; }}
    QTabWidget::pane {{ border: none; }}
    QTabBar {{ qproperty-drawBase: 0; }}
    QTabBar::tab {{ background: transparent; color: {theme.quiet_text}; padding: 6px 14px;
                    border-bottom: 3px solid transparent; }}
    QTabBar::tab:selected {{ color: {theme.text}; font-weight: 600; border-bottom-color: {theme.accent}; }}
    QTabBar::tab:focus {{ border-bottom-color: {theme.text}; }}
    QLineEdit, QPlainTextEdit {{ background: {theme.surface}; border: 1px solid {theme.line}; border-radius: 5px;
                                 padding: 4px 6px; }}
    QLineEdit:focus {{ border: 2px solid {theme.accent}; padding: 3px 5px; }}
    QComboBox, QSpinBox {{ padding: 3px 4px; }}
    QLineEdit[wrong="true"] {{ border: 2px solid {theme.bad}; background: {theme.tone_surface["bad"]};
                               padding: 3px 5px; }}
    QLabel[role="wrong"] {{ color: {theme.bad}; }}
    QLabel[role="heading"] {{ font-size: 15pt; font-weight: 700; }}
    QPushButton[role="main"]:enabled {{ background: {theme.accent}; color: {theme.on_accent}; font-weight: 600; }}
    QStatusBar {{ color: {theme.quiet_text}; }}
    """
