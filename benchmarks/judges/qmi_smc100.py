"""QMI's Newport SMC100CC on the simulated SMC100 chain."""

from __future__ import annotations

import qmi
from protocol import Judge, close_to, until
from qmi.instruments.newport.actuators import LinearActuator
from qmi.instruments.newport.smc_100cc import Newport_SMC100CC

STAGE = LinearActuator(-360.0, 360.0, 20.0, 1e-6, 1e-3, 100.0, 1e-3)


def main() -> None:
    judge = Judge("qmi", "Newport_SMC100CC on the simulated SMC100 chain")
    qmi.start("judge", None)
    try:
        descriptor = f"serial:{judge.endpoints['sensor-arms']}"
        controller = qmi.make_instrument(
            "smc", Newport_SMC100CC, transport=descriptor, serial="1", actuators={1: STAGE, 2: STAGE}
        )
        controller.open()
        try:
            trial(judge, controller)
        finally:
            controller.close()
    finally:
        qmi.stop()
    judge.done()


def trial(judge: Judge, controller: Newport_SMC100CC) -> None:
    """Everything it can do without touching the flash memory."""
    judge.check("identity", lambda: controller.get_idn(2).model, lambda value: "SMC" in value)
    judge.check("stage", lambda: controller.get_stage_identifier(2), lambda value: "SENSOR-ZENITH" in value)
    judge.check(
        "state after a reset",
        lambda: controller.get_positioner_error_and_state(2),
        lambda value: "NOT REFERENCED" in value[1] and value[0] == [],
    )
    judge.refused("no move before homing", lambda: controller.move_absolute(5.0, 2), "NOT REFERENCED")
    controller.home_search(2)
    judge.check("homing ends ready", lambda: until(lambda: "READY" in state(controller)), bool)
    controller.move_absolute(12.5, 2)
    judge.check("the motion ends", lambda: until(lambda: "READY" in state(controller)), bool)
    judge.check("position", lambda: controller.get_position(2), close_to(12.5))
    judge.refused("a move beyond the limits", lambda: controller.move_absolute(200.0, 2), "out of limits")
    judge.check("set-point", lambda: controller.get_setpoint(2), close_to(12.5))
    controller.move_relative(-2.5, 2)
    judge.check("the relative motion ends", lambda: until(lambda: "READY" in state(controller)), bool)
    judge.check("position after it", lambda: controller.get_position(2), close_to(10.0))
    judge.check("time of a motion of 10 degree", lambda: controller.get_motion_time(10.0, 2), close_to(2.0, 0.01))
    judge.check("velocity", lambda: controller.get_velocity(2), close_to(20.0))
    judge.check("acceleration", lambda: controller.get_acceleration(2), close_to(10.0))
    judge.check("lower soft limit", lambda: controller.get_negative_software_limit(2), lambda value: float(value) <= 0)
    judge.check("upper soft limit", lambda: controller.get_positive_software_limit(2), lambda value: float(value) >= 0)
    judge.check("inputs", lambda: controller.get_ttl_input_value(2), lambda value: 0 <= int(value) <= 15)
    controller.set_ttl_output_value(5, 2)
    judge.check("outputs are kept", lambda: controller.get_ttl_output_value(2), lambda value: int(value) == 5)
    controller.set_ttl_output_value(0, 2)
    judge.check("no error is left", lambda: controller.get_error(2), lambda value: value[0] == "@")
    controller.stop_motion(2)


def state(controller: Newport_SMC100CC) -> str:
    """State in QMI's words."""
    return str(controller.get_positioner_error_and_state(2)[1])


if __name__ == "__main__":
    main()
