import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as wire

from firmware_model.autopilot.modes import Mode
from gustproof.flight.endpoint.families import FAMILIES, describe_fail_safe, mode_parameters, takes_thrust

PX4, ARDUPILOT = FAMILIES[wire.MAV_AUTOPILOT_PX4], FAMILIES[wire.MAV_AUTOPILOT_ARDUPILOTMEGA]


@pytest.mark.parametrize(
    ("kind", "torques", "standby", "takes_off", "bytewise"),
    [
        (wire.MAV_AUTOPILOT_PX4, True, True, False, True),
        (wire.MAV_AUTOPILOT_GENERIC, True, False, False, True),
        (wire.MAV_AUTOPILOT_ARDUPILOTMEGA, False, False, True, False),
    ],
)
def test_families_differ_in_what_they_take(
    kind: int, torques: bool, standby: bool, takes_off: bool, bytewise: bool
) -> None:
    family = FAMILIES[kind]
    told = family.takes_torques, family.streams_on_standby, family.mode_takes_off, family.bytewise
    assert told == (torques, standby, takes_off, bytewise)


@pytest.mark.parametrize("mode", Mode)
def test_px4s_modes_have_a_main_and_a_sub_mode(mode: Mode) -> None:
    main, sub = mode_parameters(mode.value)
    assert int(main) << 16 | int(sub) << 24 == mode.value


@pytest.mark.parametrize("mode", sorted(ARDUPILOT.modes | ARDUPILOT.takeover_modes | {65535}))
def test_ardupilots_modes_are_one_number(mode: int) -> None:
    assert mode_parameters(mode) == (mode, 0.0)


def test_ardupilots_modes_are_those_that_its_clients_name() -> None:
    names = mavutil.mode_mapping_acm
    assert {names[mode] for mode in ARDUPILOT.modes} == {"GUIDED", "GUIDED_NOGPS"}
    assert (names[ARDUPILOT.mode], names[ARDUPILOT.hold_mode]) == ("GUIDED", "BRAKE")
    piloted = {"STABILIZE", "ACRO", "ALT_HOLD", "LOITER", "SPORT", "POSHOLD", "BRAKE"}
    assert {names[mode] for mode in ARDUPILOT.takeover_modes} == piloted


@pytest.mark.parametrize(
    ("options", "is_thrust"), [(None, True), (0.0, False), (7.0, False), (8.0, True), (25.0, True)]
)
def test_thrust_is_one_by_its_bit(options: float | None, is_thrust: bool) -> None:
    assert takes_thrust({"GUID_OPTIONS": options}) is is_thrust
    assert takes_thrust({})


def test_fail_safe_is_named_by_its_number() -> None:
    names = "Position", "Altitude", "Stabilized", "Return", "Land", "Hold", "Terminate", "Disarm", "unknown"
    for number, name in (*enumerate(names), (-1, "unknown")):
        told = describe_fail_safe(PX4, {"COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": number})
        action = f"enters its fail-safe: {name} (COM_OBL_RC_ACT {number})"
        assert told == f"if set-points stop, PX4 {action} after 0.5 s (COM_OF_LOSS_T)"
    told = describe_fail_safe(ARDUPILOT, {"GUID_TIMEOUT": 3.0})
    assert told == "if set-points stop, ArduPilot levels and holds its height after 3 s (GUID_TIMEOUT)"
