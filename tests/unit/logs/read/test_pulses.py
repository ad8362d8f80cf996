import numpy as np
import pytest

from gustproof.logs.read.pulses import motor_commands, output_commands


def test_motors_are_at_the_outputs_that_the_functions_name():
    pulses = {1: np.array([1000.0]), 2: np.array([1500.0]), 3: np.array([2000.0])}
    for function in range(30, 90):
        of_motors = function in (*range(33, 41), *range(82, 86))
        found = motor_commands(pulses, {"SERVO2_FUNCTION": function})
        assert found is not None
        assert found.tolist() == ([[0.5]] if of_motors else [[0.0, 0.5, 1.0]])
    assert motor_commands({5: np.array([1000.0])}, {}) is None


@pytest.mark.parametrize(("times", "beyond"), [(0.96, False), (1.04, True)])
def test_outputs_are_of_dshot_by_what_no_pulse_is(times, beyond):
    random = np.random.default_rng(1)

    def is_pulses(low: np.ndarray, high: np.ndarray) -> bool:
        outputs = np.concatenate([low, high])[:, None]
        of_dshot = np.clip((outputs - 48.0) / 1999.0, 0.0, 1.0)
        found = output_commands(outputs)
        assert np.array_equal(found, np.clip((outputs - 1000.0) / 1000.0, 0.0, 1.0)) or np.array_equal(found, of_dshot)
        return not np.array_equal(found, of_dshot)

    flown = random.uniform(1100.0, 1900.0, 9900)
    assert is_pulses(np.full(200, 700.0 * times), flown) is beyond  # no pulse is shorter
    assert is_pulses(np.full(round(100 * times), 200.0), flown) is not beyond  # of 10,000: a few are damaged
    parked = round(1000 * times)
    assert is_pulses(np.full(parked, 900.0), random.uniform(750.0, 990.0, 2000 - parked)) is beyond
