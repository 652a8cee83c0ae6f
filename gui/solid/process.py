"""The process that renders: reads what to draw as lines of JSON, writes pictures.

A request has the keys ``width`` and ``height`` (pixels), ``stance``, ``camera``, ``light``, ``theme`` and ``folder``
(of the run, or null); ``fine`` renders twice as fine and averages. The answer is a line of JSON with ``width``,
``height``, ``places`` (pixels, :meth:`gui.solid.scene.Scene.where`), ``seconds`` and ``problem``, and then the
picture's bytes, red, green and blue of each pixel by rows. Nothing here needs Qt.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gui.solid.geometry import Camera, Stance

_NICENESS = 2  # a scan on the same machine comes first


class Studio:
    """A plotter without a screen, and the scene in it."""

    def __init__(self) -> None:
        import pyvista as pv

        from gui.solid.scene import Scene

        self._plotter = pv.Plotter(off_screen=True)
        self._plotter.render_window.SetMultiSamples(0)  # a software renderer takes three times as long with them
        self._scene = Scene(self._plotter)
        self._folder: str | None = ""
        self._problem = ""

    def picture(self, request: dict[str, Any]) -> tuple[dict[str, Any], NDArray[np.uint8]]:
        """Draw; returns the line of the answer and the picture, shape (height, width, 3)."""
        if request["folder"] != self._folder:
            self._take(request["folder"])
        began = time.perf_counter()
        width, height, finer = int(request["width"]), int(request["height"]), 2 if request["fine"] else 1
        stance, camera = Stance(*request["stance"]), Camera(*request["camera"])
        self._scene.show_theme(request["theme"])
        self._scene.show_light(request["light"])
        self._plotter.window_size = [finer * width, finer * height]
        self._scene.stand(stance)
        self._scene.look(camera, stance)
        self._plotter.render()
        pixels = np.asarray(self._plotter.screenshot(return_img=True))[..., :3]
        if finer > 1:
            pixels = pixels.reshape(height, finer, width, finer, 3).mean(axis=(1, 3)).round().astype(np.uint8)
        answer = {
            "width": width,
            "height": height,
            "places": self._scene.where(stance, width, height),
            "seconds": time.perf_counter() - began,
            "problem": self._problem,
        }
        return answer, pixels

    def _take(self, folder: str | None) -> None:
        from gui.solid.scene import sample_of

        sample = sample_of(Path(folder) if folder else None)
        self._scene.show_sample(sample)
        self._folder, self._problem = folder, sample.problem


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer until no more is asked."""
    studio = Studio()
    for line in requests:
        answer, pixels = studio.picture(json.loads(line))
        answers.write(json.dumps(answer).encode() + b"\n")
        answers.write(np.ascontiguousarray(pixels).tobytes())
        answers.flush()


def main() -> None:
    """Serve the window at the other end of the pipes."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever libraries print must not stand among the pictures
    with contextlib.suppress(OSError):
        os.nice(_NICENESS)
    with contextlib.suppress(BrokenPipeError):
        serve(sys.stdin.buffer, answers)
    os._exit(0)  # no library has anything to tidy up


if __name__ == "__main__":
    main()
