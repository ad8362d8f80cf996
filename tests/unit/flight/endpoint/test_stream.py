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
