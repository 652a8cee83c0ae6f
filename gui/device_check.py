"""``python -m gui.device_check``: ask every device who it is and how it is, and print the answers as JSON lines.

A process of its own, so that a device that hangs holds no window up. With ``--simulate`` the simulated laboratory is
started for the question.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

from drivers.check import check_devices
from drivers.configuration import endpoints, read_devices
from drivers.errors import ConfigurationError, DeviceError
from drivers.lock import InstrumentLock
from instrument.errors import InputError
from instrument.laboratories import laboratory_factory


def check(devices: Path) -> None:
    """Print one line a device."""
    form = read_devices(devices)
    with InstrumentLock(endpoints(form)):
        for result in check_devices(form):
            print(json.dumps(result.as_dict()), flush=True)


def main() -> int:
    """Check the file that is named, or the simulated laboratory."""
    try:
        if sys.argv[1] == "--simulate":
            with (
                tempfile.TemporaryDirectory(prefix="goniotwin-") as folder,
                laboratory_factory()(Path(folder), speed=float(sys.argv[2])) as laboratory,
            ):
                check(laboratory.inputs.devices)
        else:
            check(Path(sys.argv[1]))
    except (InputError, ConfigurationError, DeviceError) as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
