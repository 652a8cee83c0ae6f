"""InstrumentKit's NewportESP301 on the simulated ESP301."""

from __future__ import annotations

import instruments as ik
from protocol import Judge, close_to, until


def degrees(quantity: object) -> float:
    """Number of a quantity, whatever it counts in."""
    return float(getattr(quantity, "magnitude", quantity))


def main() -> None:
    judge = Judge("instrumentkit", "NewportESP301 on the simulated ESP301")
    controller = ik.newport.NewportESP301.open_serial(judge.endpoints["esp301"], 19200, timeout=5.0)
    axis = controller.axis[1]
    judge.check("units are degrees", lambda: axis.units, lambda value: "deg" in str(value))
    axis.enable()
    axis.search_for_home(search_mode=1)
    judge.check("homing ends", lambda: until(lambda: axis.is_motion_done), bool)
    judge.check("home is zero", lambda: degrees(axis.position), close_to(0.0))
    axis.velocity = 10.0
    judge.check("velocity is kept", lambda: degrees(axis.velocity), close_to(10.0))
    axis.acceleration = 5.0
    judge.check("acceleration is kept", lambda: degrees(axis.acceleration), close_to(5.0))
    axis.move(15.0, absolute=True)
    judge.check("the motion ends", lambda: until(lambda: axis.is_motion_done), bool)
    judge.check("it stands where it was sent", lambda: degrees(axis.position), close_to(15.0))
    axis.move(-5.0, absolute=False)
    judge.check("the relative motion ends", lambda: until(lambda: axis.is_motion_done), bool)
    judge.check("it stands where it was sent relatively", lambda: degrees(axis.position), close_to(10.0))
    judge.refused("a velocity above the stage's is refused", lambda: setattr(axis, "velocity", 1e4), "velocity")
    axis.velocity, axis.acceleration = 20.0, 10.0
    axis.disable()
    judge.done()


if __name__ == "__main__":
    main()
