from pymavlink.dialects.v20 import all as wire

from firmware_model.mavlink.services import clock


def test_timesync_is_answered_with_the_stamps_clock(craft, ask):
    craft.stamp_us = 1_234_567
    (answer,) = ask(clock.make_service(craft), wire.MAVLink_timesync_message(0, 99))
    assert (answer.tc1, answer.ts1) == (1_234_567_000, 99)


def test_answer_to_a_timesync_is_not_answered(craft, ask):
    assert ask(clock.make_service(craft), wire.MAVLink_timesync_message(5, 99)) == []


def test_ping_comes_back_to_its_sender_once(craft, ask):
    service = clock.make_service(craft)
    (answer,) = ask(service, wire.MAVLink_ping_message(77, 3, 0, 0))
    assert (answer.time_usec, answer.seq, answer.target_system, answer.target_component) == (77, 3, 255, 190)
    assert ask(service, wire.MAVLink_ping_message(77, 3, 1, 1)) == []


def test_system_time_has_no_date(craft):
    craft.stamp_us = 2_500_000
    message = clock.make_service(craft).streams[wire.MAVLINK_MSG_ID_SYSTEM_TIME].message()
    assert (message.time_unix_usec, message.time_boot_ms) == (0, 2500)
