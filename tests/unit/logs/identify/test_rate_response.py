import numpy as np
import pytest
from scipy.linalg import expm

from gustproof.logs.identify.rate_response import command_response, prediction_errors

LAG, DELAY, DAMPING = 0.03, 0.0043, 0.8


@pytest.mark.parametrize("square", [False, True])
def test_command_response_is_that_of_a_fine_integration(square):
    random = np.random.default_rng(2)
    command_time, time = np.sort(random.uniform(0.0, 0.3, 40)), np.sort(random.uniform(0.0, 0.35, 60))
    command, response = random.standard_normal((40, 2)), np.empty((60, 2))
    model = np.array([LAG, DELAY, DAMPING])
    bins, work = np.arange(60), (np.empty((2, 2)), np.empty((4, 6)))
    command_response(command_time, command, time, bins, model, square, *work, response)
    h = 5e-6
    fine = np.arange(command_time[0] + DELAY, time[-1], h)
    held = command[np.searchsorted(command_time + DELAY, fine + 1e-12, side="right") - 1]
    speed, rate, rates = command[0].copy(), np.zeros(2), np.zeros((len(fine), 2))
    for k, u in enumerate(held):
        middle = u + (speed - u) * np.exp(-0.5 * h / LAG)
        rate = rate + h * ((middle**2 if square else middle) - DAMPING * rate)
        speed, rates[k] = u + (speed - u) * np.exp(-h / LAG), rate
    expected = np.column_stack([np.interp(time, fine + h, column, left=0.0) for column in rates.T])
    assert response == pytest.approx(expected, abs=2e-5)
    pairs = np.empty((30, 2))
    command_response(command_time, command, time, bins[::2].copy(), model, square, *work, pairs)
    assert pairs == pytest.approx(0.5 * (response[::2] + response[1::2]), rel=1e-12)


def test_command_response_at_even_steps_shares_their_exponentials():
    """Stamps of microseconds differ by rounding; a lost sample, and a command between samples, take others."""
    random = np.random.default_rng(3)
    command_time, time = 0.013 + np.arange(30) / 50.0, np.delete(np.arange(120) / 200.0, 50)
    command, model, bins = random.standard_normal((30, 1)), np.array([LAG, DELAY, DAMPING]), np.arange(119)
    work = np.empty((2, 1)), np.empty((4, 6))
    even, uneven = np.empty((119, 1)), np.empty((119, 1))
    command_response(command_time, command, time, bins, model, False, *work, even)
    moved = time + random.uniform(-2e-10, 2e-10, 119)
    command_response(command_time, command, moved, bins, model, False, *work, uneven)
    assert even == pytest.approx(uneven, abs=1e-8)


def test_prediction_errors_are_those_of_the_joint_distribution():
    """The likelihood by prediction errors is that of all samples at once, from the covariances of the states."""
    time = np.array([0.0, 0.004, 0.008, 0.0123, 0.02, 0.05, 0.054])
    count = np.array([1.0, 2.0, 1.0, 1.0, 4.0, 1.0, 2.0])
    noise, slow, slow_drive, fast, fast_drive = 1e-4, 0.7, 3.0, 20.0, 50.0
    F = np.array([[-DAMPING, 1.0, 1.0], [0.0, -slow, 0.0], [0.0, 0.0, -fast]])
    P = np.diag([1e4, slow_drive / (2.0 * slow), fast_drive / (2.0 * fast)])
    fine, n = 400, len(time)
    covariances, steps = [P], [np.eye(3)]
    for h in np.diff(time):
        A = expm(F * h / fine)
        for _ in range(fine):
            P = A @ P @ A.T + np.diag([0.0, slow_drive, fast_drive]) * h / fine
        covariances.append(P)
        steps.append(expm(F * h))
    joint = np.empty((n, n))
    for i in range(n):
        chain = np.eye(3)
        for j in range(i, n):
            chain = chain if j == i else steps[j] @ chain
            joint[i, j] = joint[j, i] = (chain @ covariances[i])[0, 0]
    joint += np.diag(noise / count)
    signals = np.random.default_rng(3).multivariate_normal(np.zeros(n), joint, 2).T
    errors, variance, start = np.empty((n, 2)), np.empty(n), np.eye(1, n)[0]
    model = np.array([DAMPING, noise, slow, slow_drive, fast, fast_drive])
    prediction_errors(time, count, start, signals, model, np.empty((3, 2)), errors, variance)
    whitened = np.linalg.solve(np.linalg.cholesky(joint), signals)
    assert errors / np.sqrt(variance)[:, None] == pytest.approx(whitened, rel=2e-3, abs=2e-3)
    assert np.log(variance).sum() == pytest.approx(np.linalg.slogdet(joint)[1], abs=0.01)
