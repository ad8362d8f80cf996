import pytest
from pymavlink.dialects.v20 import all as wire

from gustproof.flight.endpoint.stream import SampleStream


@pytest.mark.parametrize(("interval_us", "told"), [(4000, ""), (4020, ""), (5200, "5.2 ms"), (3000, "3 ms")])
def test_samples_of_another_rate_than_the_law_s_are_told(interval_us, told):
    stream = SampleStream("law", 0.004, (wire.MAVLINK_MSG_ID_HIGHRES_IMU,))
    assert stream.describe() == ""
    for k in range(5):
        stream.observe(1_000_000 + k * interval_us)
    assert stream.describe() == (told and f"HIGHRES_IMU comes every {told}: interpolated to the law's 4 ms")


def stream(*messages: int) -> SampleStream:
    return SampleStream("law", 0.004, messages or (wire.MAVLINK_MSG_ID_HIGHRES_IMU,))


@pytest.mark.parametrize(("interval_us", "told"), [(3961, False), (3959, True), (4039, False), (4041, True)])
def test_an_interval_within_a_hundredth_of_the_law_s_is_the_law_s(interval_us, told):
    samples = stream()
    for k in range(3):
        samples.observe(1_000_000 + k * interval_us)
    assert bool(samples.describe()) is told


@pytest.mark.parametrize(("interval_us", "is_flyable"), [(4000, True), (8790, True), (8810, False), (20_000, False)])
def test_samples_are_too_few_once_ten_intervals_are_above_twice_the_law_s(interval_us, is_flyable):
    samples = stream()
    samples.on_answer(accepted=False, declined="no")
    for k in range(11):
        assert not samples.is_refused
        assert samples.is_flyable is (is_flyable and k > 2)
        samples.observe(1_000_000 + k * interval_us)
    assert (samples.is_flyable, samples.is_refused) == (is_flyable, not is_flyable)
    assert bool(samples.describe_fault()) is not is_flyable


def test_time_that_stands_is_flyable_and_the_median_is_of_the_last_ten():
    samples = stream()
    samples.observe(0)
    assert samples.is_flyable
    for k in range(25):
        samples.observe((k + 1) * 20_000 if k < 10 else 200_000 + (k - 9) * 4000)
    assert samples.interval_us == 4000
    assert samples.describe_fault() == ""


def test_the_next_message_is_tried_after_fifteen_requests_in_silence_or_a_refusal_and_the_last_one_for_ever():
    first, second = wire.MAVLINK_MSG_ID_HIGHRES_IMU, wire.MAVLINK_MSG_ID_RAW_IMU
    samples = stream(first, second)
    asked = [samples.request() for _ in range(40)]
    assert asked == [(float(first), 4000)] * 15 + [(float(second), 4000)] * 25
    refused = stream(first, second)
    refused.on_answer(accepted=False, declined="no")
    assert refused.request() == (float(second), 4000)
    heard = stream(first, second)
    heard.observe(4000)
    assert [heard.request() for _ in range(40)] == [(float(first), 4000)] * 40
