"""PyMeasure's ESP300 on the simulated ESP301."""

from __future__ import annotations

from protocol import Judge, close_to, until
from pymeasure.adapters import VISAAdapter
from pymeasure.instruments.newport import ESP300


def main() -> None:
    judge = Judge("pymeasure", "ESP300 on the simulated ESP301")
    adapter = VISAAdapter(
        f"ASRL{judge.endpoints['esp301']}::INSTR",
        visa_library="@py",
        read_termination="\r\n",
        write_termination="\r",
        timeout=5000,
    )
    controller = ESP300(adapter)
    axis = controller.x
    controller.clear_errors()
    judge.check("errors are empty", lambda: controller.errors, lambda value: value == [])
    judge.check("units", lambda: axis.units, lambda value: value == "degree")
    axis.position = 10.0
    judge.check(
        "a move with the motor off is an axis error in its words",
        lambda: [str(error) for error in controller.errors],
        lambda value: len(value) == 1 and "axis 1" in value[0] and "MOTOR NOT ENABLED" in value[0],
    )
    axis.enable()
    judge.check("enabled", lambda: axis.enabled, bool)
    axis.home(1)
    judge.check("homing is a motion", lambda: axis.motion_done, lambda value: not value)
    judge.check("homing ends", lambda: until(lambda: axis.motion_done), bool)
    judge.check("home is zero", lambda: axis.position, close_to(0.0))
    axis.position = 12.5
    axis.wait_for_stop()
    judge.check("it stands where it was sent", lambda: axis.position, close_to(12.5))
    axis.define_position(100.0)
    judge.check("a defined position", lambda: axis.position, close_to(100.0))
    axis.home(1)
    judge.check("home again", lambda: until(lambda: axis.motion_done), bool)
    axis.right_limit = 30.0
    judge.check("a soft limit is kept", lambda: axis.right_limit, close_to(30.0))
    axis.position = 40.0
    judge.check(
        "a move beyond it is refused",
        lambda: [str(error) for error in controller.errors],
        lambda value: len(value) == 1 and "axis 1" in value[0],
    )
    axis.right_limit = 185.0
    axis.disable()
    judge.check("disabled", lambda: axis.enabled, lambda value: not value)
    judge.check("no error is left", lambda: controller.errors, lambda value: value == [])
    judge.done()


if __name__ == "__main__":
    main()
