"""Parameters of an external autopilot, read back: who is asked how often, and what counts as wrong."""

import struct

import pytest
from pymavlink.dialects.v20 import all as wire

from firmware_model.external.read_back import ParameterReader
from firmware_model.mavlink.frames import Message

REAL, WHOLE = wire.MAV_PARAM_TYPE_REAL32, wire.MAV_PARAM_TYPE_INT32


def value(name: str, told: float, kind: int = REAL) -> Message:
    """Return a PARAM_VALUE as it arrives."""
    packer = wire.MAVLink(None, 1, 1)
    sent = wire.MAVLink_param_value_message(name.encode(), told, kind, 1, 0).pack(packer)
    (message,) = wire.MAVLink(None).parse_buffer(bytearray(sent))
    return message


def bits(number: int) -> float:
    told: float = struct.unpack("<f", struct.pack("<i", number))[0]
    return told


def read(reader: ParameterReader, *answers: Message) -> str:
    """Have an autopilot answer at once, and for the rest never; return what is wrong."""
    for _ in range(40):
        reader.next_names()
        for answer in answers:
            reader.take(answer)
    assert reader.finished
    return reader.describe_faults()


def test_a_value_in_single_precision_is_the_one_that_was_set():
    told = struct.unpack("<f", struct.pack("<f", 0.0082709))[0]
    assert read(ParameterReader({"MC_ROLLRATE_D": "0.0082709"}), value("MC_ROLLRATE_D", told)) == ""


@pytest.mark.parametrize("told", [0.15, 0.0, -0.6, 0.60001, float("nan")])
def test_another_value_is_told_with_both(told):
    said = read(ParameterReader({"MC_ROLLRATE_P": "0.6"}), value("MC_ROLLRATE_P", told))
    assert said == f"it has MC_ROLLRATE_P {told:.7g} where 0.6 was set"


def test_several_wrong_ones_are_counted():
    reader = ParameterReader({"A": "1", "B": "2", "C": "3"})
    said = read(reader, value("A", 1.0), value("B", 0.0), value("C", 0.0))
    assert said == "it has B 0 where 2 was set, and 1 more like it"


def test_autopilot_that_answers_for_nothing_is_refused():
    reader = ParameterReader({"A": "1", "B": "2"}, watched=["C"])
    assert read(reader, value("C", 1.0)) == "it answers for none of the 2 parameters that were set"


def test_autopilot_without_parameters_to_read_is_ready_at_once():
    reader = ParameterReader()
    assert (reader.finished, reader.next_names(), reader.describe_faults()) == (True, [], "")


def test_an_unknown_name_is_refused_if_the_vehicle_rests_on_it_and_told_otherwise():
    values = {"CA_ROTOR0_PX": "0.22", "MY_OWN": "1", "OF_2026": "0", "KNOWN": "1"}
    reader = ParameterReader(values, vital=["CA_ROTOR0_PX", "KNOWN"], optional=["OF_2026"], watched=["MC_YAW_P"])
    assert read(reader, value("KNOWN", 1.0)) == "it has no parameter CA_ROTOR0_PX"
    assert reader.unknown == ["CA_ROTOR0_PX", "MY_OWN"]
    assert read(ParameterReader(values, vital=["KNOWN"], optional=["OF_2026"]), value("KNOWN", 1.0)) == ""


def test_answer_that_comes_late_is_taken():
    reader = ParameterReader({"A": "1", "B": "1"})
    assert read(reader, value("B", 1.0)) == ""
    reader.take(value("A", 2.0))
    assert (reader.unknown, reader.describe_faults()) == ([], "it has A 2 where 1 was set")


@pytest.mark.parametrize(("bytewise", "sent"), [(True, bits(4)), (False, 4.0)])
def test_whole_numbers_come_as_bits_from_px4_and_cast_from_ardupilot(bytewise, sent):
    reader = ParameterReader({"COM_RC_IN_MODE": "4"}, bytewise=bytewise)
    assert read(reader, value("COM_RC_IN_MODE", sent, WHOLE)) == ""
    assert reader.reported == {"COM_RC_IN_MODE": 4.0}
    wrong = ParameterReader({"COM_RC_IN_MODE": "5"}, bytewise=bytewise)
    assert read(wrong, value("COM_RC_IN_MODE", sent, WHOLE)) == "it has COM_RC_IN_MODE 4 where 5 was set"


@pytest.mark.parametrize(
    ("given", "told", "kind", "fault"),
    [
        ("53.574", 53.0, wire.MAV_PARAM_TYPE_INT16, ""),
        ("-0.5", 0.0, wire.MAV_PARAM_TYPE_INT16, ""),
        ("53.574", 52.0, wire.MAV_PARAM_TYPE_INT16, "it has INS_GYRO_FILTER 52 where 53.574 was set"),
        ("53", 52.0, wire.MAV_PARAM_TYPE_INT16, "it has INS_GYRO_FILTER 52 where 53 was set"),
        ("53.574", 53.0, REAL, "it has INS_GYRO_FILTER 53 where 53.574 was set"),
    ],
)
def test_fraction_of_a_whole_number_is_told_and_flown(given, told, kind, fault):
    reader = ParameterReader({"INS_GYRO_FILTER": given}, bytewise=False)
    assert read(reader, value("INS_GYRO_FILTER", told, kind)) == fault
    assert reader.rounded == ({} if fault else {"INS_GYRO_FILTER": told})


def test_every_name_is_asked_for_before_one_is_asked_for_again():
    reader = ParameterReader({f"P{i}": "1" for i in range(25)}, watched=["P3", "Q"])
    rounds = [reader.next_names() for _ in range(3)]
    assert [len(names) for names in rounds] == [10, 10, 10]
    assert len({name for names in rounds for name in names}) == 26


def test_value_of_nobody_who_was_asked_is_ignored():
    reader = ParameterReader({"A": "1"})
    reader.take(value("B", 1.0))
    assert reader.reported == {}
