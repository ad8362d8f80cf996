import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.mavlink.frames import RejectReason
from firmware_model.types import AttitudeTarget, ImuSample, TorqueCommand
from gustproof.flight.controllers.stepper import CheckedStepper
from gustproof.flight.endpoint.core import ControllerCore, sample_time
from gustproof.law.form import Law, Output, Provenance


def integrator(output: Output = Output.TORQUE) -> Law:
    """u = x, x+ = x + gyro, axis by axis, within 2."""
    return Law(
        name="integrator",
        A=np.eye(3),
        B=np.hstack([np.eye(3), np.zeros((3, 3))]),
        C=np.eye(3),
        D=np.zeros((3, 6)),
        G=np.zeros((3, 3)),
        H=np.zeros((3, 3)),
        dt=0.004,
        limits=np.full(3, 2.0),
        output=output,
        provenance=Provenance(design="test", vehicle="paper"),
    )


def sample(time_us: int, roll_rate: float = 1.0) -> ImuSample:
    return ImuSample(time_us=time_us, gyro_B=(roll_rate, 0.0, 0.0), specific_force_B=(0.0, 0.0, -9.8))


def test_first_answer_comes_from_the_stated_initial_state():
    controller = ControllerCore(integrator(), (10.0, 10.0, 10.0), 0.5)
    assert controller.fractions == (0.0, 0.0, 0.0)
    answer = controller.answer(sample(0))
    assert answer == TorqueCommand(time_us=0, torque_B=(0.0, 0.0, 0.0), throttle=None)


def test_law_that_begins_afresh_answers_as_at_first():
    controller = ControllerCore(integrator(), (10.0, 10.0, 10.0), 0.5)
    before = [controller.answer(sample(time_us)).torque_B for time_us in (0, 4000, 8000)]
    first = controller.answer(sample(12_000), reset=True).torque_B
    assert [first, *(controller.answer(sample(time_us)).torque_B for time_us in (16_000, 20_000))] == before
    assert before[2] != before[0]


def test_repeated_sample_does_not_begin_the_law_afresh():
    controller = ControllerCore(integrator(), (10.0, 10.0, 10.0), 0.5)
    controller.answer(sample(0), reset=True)
    controller.answer(sample(0), reset=True)
    assert controller.answer(sample(4000)).torque_B == (np.float32(0.1), 0.0, 0.0)


def test_law_steps_once_a_stamp_and_repeats_its_answer():
    controller = ControllerCore(integrator(), (10.0, 10.0, 10.0), 0.5)
    controller.answer(sample(0))
    first = controller.answer(sample(4000))
    assert controller.answer(sample(4000)) == first
    assert isinstance(first, TorqueCommand)
    assert first.torque_B == (np.float32(0.1), 0.0, 0.0)


def test_sample_from_the_past_is_stale():
    controller = ControllerCore(integrator(), (10.0, 10.0, 10.0), 0.5)
    controller.answer(sample(4000))
    assert controller.answer(sample(0)) is RejectReason.STALE


@pytest.mark.parametrize("limit", [0.35, 1.5, 10.0])
def test_fraction_is_the_float32_of_command_over_limit(limit):
    controller = ControllerCore(integrator(), (limit, limit, limit), 0.5)
    controller.answer(sample(0, 0.123456789))
    answer = controller.answer(sample(4000))
    assert isinstance(answer, TorqueCommand)
    assert answer.torque_B[0] == float(np.float32(0.123456789 / limit))


def test_rates_are_sent_as_an_attitude_target_without_attitude():
    controller = ControllerCore(integrator(Output.RATES), (1.0, 1.0, 1.0), 0.5)
    controller.answer(sample(0, 0.1))
    answer = controller.answer(sample(4000))
    assert answer == AttitudeTarget(time_us=4000, q_NB=None, omega_B=(float(np.float32(0.1)), 0.0, 0.0), thrust=0.5)


def test_command_stays_within_the_laws_limits():
    controller = ControllerCore(replace(integrator(), limits=np.full(3, 0.5)), (1.0, 1.0, 1.0), 0.5)
    controller.answer(sample(0, 100.0))
    answer = controller.answer(sample(4000))
    assert isinstance(answer, TorqueCommand)
    assert answer.torque_B[0] == 0.5


def test_the_law_feels_the_force_of_the_sample():
    # u = roll and pitch by gravity
    D = np.vstack([np.eye(2, 8, 6), np.zeros((1, 8))])
    law = replace(integrator(), B=np.zeros((3, 8)), D=D, limits=np.full(3, 20.0))
    tilted = sample(0)._replace(specific_force_B=(0.0, -9.8 * math.sin(0.2), -9.8 * math.cos(0.2)))
    answer = ControllerCore(law, (20.0, 20.0, 20.0), 0.5).answer(tilted)
    assert isinstance(answer, TorqueCommand)
    assert answer.torque_B == pytest.approx((0.01, 0.0, 0.0), rel=1e-6)


def test_the_reference_is_that_of_the_newest_stamp_that_has_come():
    # u = reference phi: the law passes it through.
    D = np.hstack([np.zeros((3, 3)), np.eye(3)])
    law = replace(integrator(), A=np.zeros((3, 3)), B=np.zeros((3, 6)), C=np.zeros((3, 3)), D=D)
    references = [(4000, (0.25, 0.0, 0.0)), (6000, (0.5, 0.0, 0.0)), (16_000, (0.75, 0.0, 0.0))]
    controller = ControllerCore(law, (1.0, 1.0, 1.0), 0.5, references)
    asked = [controller.answer(sample(time_us)).torque_B[0] for time_us in (0, 4000, 8000)]
    asked += [controller.answer(sample(time_us), reset=True).torque_B[0] for time_us in (12_000, 16_000)]
    assert asked == [0.0, 0.25, 0.5, 0.5, 0.75]


def test_samples_between_two_that_came_are_missed_and_a_fresh_law_misses_none():
    controller = ControllerCore(integrator(), (10.0, 10.0, 10.0), 0.5)
    for time_us in (1_000_000, 1_004_000, 1_012_000, 1_028_001, 1_028_002):
        controller.answer(sample(time_us))
    assert controller.missed == 1 + 3
    controller.answer(sample(2_000_000), reset=True)
    assert controller.missed == 4


def test_estimate_without_a_start_is_not_corrected():
    controller = ControllerCore(integrator(), (1.0, 1.0, 1.0), 0.5)
    controller._law.correct = lambda *_: pytest.fail("corrected")
    controller.answer(sample(4000), reset=True)
    controller.correct((0.1, 0.0, 0.0), 0.02)
    controller._law.correct = lambda *told: corrections.append(told)
    corrections: list[tuple] = []
    controller.answer(sample(8000), reset=True, attitude=(0.0, 0.0, 0.5))
    controller.correct((0.0, 0.0, 0.5), 0.02)
    controller.correct((0.0, 0.0, 0.5), 7.0)  # a tenth of a second at most
    assert corrections == [(pytest.approx((0.0, 0.0, 0.0)), pytest.approx(share)) for share in (0.1, 0.5)]


class Counting:
    """Commands the steps since its reset [N m], the rolls that it is to hold and gets, and changes what it is given."""

    def reset(self) -> None:
        self.steps = 0

    def step(self, gyro, reference, force, dt):
        self.steps += 1
        command = np.array([self.steps, reference[0], gyro[0]])
        gyro[:] = reference[:] = force[:] = math.nan
        return command


@pytest.mark.parametrize(("output", "most"), [(Output.TORQUE, 1.0), (Output.RATES, 1.5)])
def test_entry_steps_with_the_reference_and_only_torques_are_bounded(output, most):
    controller = ControllerCore(
        CheckedStepper("count", Counting(), output, 0.004), (2.0, 1.0, 1.0), 0.5, [(0, (0.25,) * 3)]
    )
    commands = []
    for time_us, roll_rate in ((4000, 0.1), (8000, 0.2), (12_000, 0.3)):
        controller.answer(sample(time_us, roll_rate))
        commands.append(controller.fractions)
    gyro = [float(np.float32(rate)) for rate in (0.1, 0.2, 0.3)]
    assert commands == [(0.5, 0.25, gyro[0]), (1.0, 0.25, gyro[1]), (most, 0.25, gyro[2])]


def test_entry_begins_afresh_where_it_is_given_and_keeps_its_own_attitude():
    controller = ControllerCore(CheckedStepper("count", Counting(), Output.TORQUE, 0.004), (10.0, 1.0, 1.0), 0.5)
    steps = []
    for time_us, reset in ((4000, False), (8000, False), (12_000, True), (16_000, False)):
        controller.answer(sample(time_us), reset=reset, attitude=(0.1, 0.2, 0.3))
        controller.correct((0.4, 0.0, 0.0), 0.02)
        steps.append(round(10.0 * controller.fractions[0]))
    assert steps == [1, 2, 1, 2]


def test_entry_without_a_sample_time_is_not_flown():
    entry = CheckedStepper("any", Counting())
    with pytest.raises(ValueError, match="'any' has no sample time"):
        ControllerCore(entry, (1.0, 1.0, 1.0), 0.5)
    entry.dt = 0.002
    assert sample_time(entry) == 0.002


def counter() -> Law:
    """u = roll rate of this sample, so that a command tells the sample that was stepped."""
    law = integrator(Output.RATES)
    D = np.hstack([np.eye(3), np.zeros((3, 3))])
    return replace(law, A=np.zeros((3, 3)), B=np.zeros((3, 6)), C=np.zeros((3, 3)), D=D)


def test_interpolating_law_takes_exact_stamps_as_they_are():
    plain, between = (ControllerCore(integrator(), (1.0, 1.0, 1.0), 0.5) for _ in range(2))
    between.interpolating = True
    for k in range(50):
        taken = sample(1_000_000 + 4000 * k, 0.1 * math.sin(k))
        assert between.answer(taken, reset=k == 0) == plain.answer(taken, reset=k == 0)


def test_interpolating_law_steps_at_its_own_instants_between_samples():
    controller = ControllerCore(counter(), (1.0, 1.0, 1.0), 0.5)
    controller.interpolating = True
    steps = []
    step = controller._law.step
    controller._law.step = lambda gyro, force: steps.append(gyro[0]) or step(gyro, force)
    for time_us in (100_000, 105_000, 110_000, 115_000, 120_000):  # 200 Hz; the rate grows by 1e-5 a microsecond
        controller.answer(sample(time_us, 1e-5 * time_us), reset=time_us == 100_000)
    expected = [1.0, 1.04, 1.08, 1.10, 1.15, 1.2]  # 112 and 116 ms are less than half a step ahead: held, not awaited
    np.testing.assert_allclose(steps, expected, atol=1e-9)


def test_lost_samples_are_bridged_by_interpolation_and_counted():
    controller = ControllerCore(integrator(), (10.0, 10.0, 10.0), 0.5)
    controller.interpolating = True
    for time_us in (100_000, 104_000, 120_000):
        controller.answer(sample(time_us, 1.0), reset=time_us == 100_000)
    assert controller.missed == 3
    assert controller.fractions[0] == pytest.approx(0.2)  # five steps of 1 before: all of the turn


def test_references_of_an_interpolating_law_count_from_its_start():
    D = np.hstack([np.zeros((3, 3)), np.eye(3)])
    law = replace(integrator(), A=np.zeros((3, 3)), B=np.zeros((3, 6)), C=np.zeros((3, 3)), D=D)
    controller = ControllerCore(law, (1.0, 1.0, 1.0), 0.5, [(0, (0.25, 0.0, 0.0)), (8000, (0.5, 0.0, 0.0))])
    controller.interpolating = True
    asked = [controller.answer(sample(9_000_000 + 4000 * k), reset=k == 0).torque_B[0] for k in range(4)]
    assert asked == [0.25, 0.25, 0.5, 0.5]


def test_heading_of_the_estimate_turns_with_the_gyro_and_ignores_a_wander():
    I, O = np.eye(3), np.zeros((3, 3))  # noqa: E741
    law = replace(
        integrator(Output.RATES),
        A=np.block([[I, O], [O, O]]),
        B=np.block([[O, O], [I, O]]),
        C=np.hstack([-I, O]),
        G=np.vstack([0.004 * I, O]),
        H=np.zeros((6, 3)),
    )  # u = -E, of its own estimate
    controller = ControllerCore(law, (1.0, 1.0, 1.0), 0.5)
    controller.answer(sample(4000, 0.0), reset=True, attitude=(0.0, 0.0, 3.0))
    for k in range(2, 1502):
        turned = 0.2 * 0.004 * (k - 1)
        controller.step(4000 * k, (0.0, 0.0, 0.2), (0.0, 0.0, -9.8))
        if k % 5 == 0:
            controller.correct((0.0, 0.0, math.remainder(3.005 + turned, 2.0 * math.pi)), 0.02)
    assert abs(controller.fractions[2] + turned) < 0.003  # two samples, and a little of 5 mrad


@pytest.mark.parametrize(
    ("stamps", "expected"),
    [
        ((100_000, 180_000), 1.0 + 0.04 * np.arange(21)),
        ((100_000, 1_100_000), 1.0 + 0.04 * np.arange(251)),
        ((100_000, 1_100_001), [1.0, 11.00001]),  # a longer silence is none to bridge
        ((100_000, 102_000), [1.0, 1.02]),  # half a step ahead is near enough
        ((100_000, 101_999), [1.0]),
    ],
)
def test_gap_is_bridged_from_the_sample_before_it(stamps, expected):
    controller = ControllerCore(counter(), (1.0, 1.0, 1.0), 0.5)
    controller.interpolating = True
    steps = []
    step = controller._law.step
    controller._law.step = lambda gyro, force: steps.append(gyro[0]) or step(gyro, force)
    for time_us in stamps:
        controller.answer(sample(time_us, 1e-5 * time_us), reset=time_us == 100_000)
    np.testing.assert_allclose(steps, expected, atol=1e-9)
