"""A small learned policy: for each axis a network of 2 x 32 tanh units, without offsets, on a short history.

Inputs of an axis are its attitude error, an integral, and the error of the rate that the attitude commands. Then come
the gyro's five latest changes from sample to sample, and two commands of its own before. The output is its torque.
Inputs and output are in units of the largest angular acceleration, with the time of lag and delay together. Attitude is
strapdown. Its error is axis times angle, shortened to the rate limit of all laws here.

The policy learns in four steps, all from fixed seeds:

1. Its teacher is the geometric PID with lead, tuned for the vehicle. Gradient descent (Adam) on drawn histories fits
   the teacher's clipped torque, with errors relative to its size, from small motions to full torque.
2. The output layer takes the least change that gives the teacher's gains at level exactly.
3. An evolution strategy perturbs all weights in antithetic pairs. It lowers the predicted error in turbulence, with
   penalties on sensitivity peak, off-nominal peaks and torque slew beyond the price of all entries. The best weights
   within the price are kept.
4. The gains at level that it found are imitated once more, as the teacher's were, so they hold up to full torque.

What it is: near level it is linear, and its figures there come of model-based search, not of experience in flight. Far
from level it is an imitation, and nothing is proved of it. It works at the sample time that it was trained at alone.

References
----------
D. P. Kingma, J. Ba, Adam: a method for stochastic optimization, ICLR 2015.
T. Salimans, J. Ho, X. Chen, S. Sidor, I. Sutskever, Evolution strategies as a scalable alternative to reinforcement
learning, 2017.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from firmware_model.config.vehicle import Vehicle
from firmware_model.types import Vector
from gustproof.baselines.geometric import GeometricGains, geometric_axis
from gustproof.baselines.geometric_lead import find_lead
from gustproof.baselines.rotation_estimate import HeldAttitude, as_vector, rotation_vector, shorten
from gustproof.baselines.tuned_gains import (
    DATA,
    design_vehicle,
    is_shipped,
    tuning_limits,
    tuning_models,
    tuning_scenario,
)
from gustproof.errors import DesignError
from gustproof.law.cascade import AxisLaw
from gustproof.lti.state_space import Matrix
from gustproof.performance.covariance import axis_performance, rms
from gustproof.synthesis.pid.tuning import AxisModels, TuningLimits

SLOPES, COMMANDS, UNITS = 5, 2, 32
INPUTS = 3 + SLOPES + COMMANDS
_ZERO: Vector = (0.0, 0.0, 0.0)
_PENALTY, _UNSTABLE, _GRID_MARGIN = 5.0, 1e3, 5e-4
"""[-] cost per logarithm beyond the price; cost of an unstable loop; share of a peak reserved between frequencies."""
_ROUNDING = 1e-6
"""[-] relative excess of the slew that counts as rounding."""
_SMALL = 0.1
"""[-] of the usual size of a first layer at the start: units begin nearly linear."""
_CLIPPED = 2.0
"""[-] output, in torque limits, up to which gains are imitated: within its limits the policy is nearly linear."""
_TWINS = {"paper": "paper", "octo": "paper", "iris": "iris"}
"""Shipped weights by vehicle: `octo` turns as `paper` does."""


class Weights(NamedTuple):
    """Weights of three axes."""

    first: Matrix
    """(3, INPUTS, UNITS) from the inputs."""
    second: Matrix
    """(3, UNITS, UNITS) between the layers."""
    last: Matrix
    """(3, UNITS, 1) to the torque."""

    @property
    def gains(self) -> Matrix:
        """(3, INPUTS) of the policy near level."""
        return np.asarray((self.first @ self.second @ self.last)[:, :, 0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PolicyUnits:
    """Scales of inputs and output, and what the teacher lends."""

    torque: Matrix
    """(3,) [N*m] of an output of 1: the torque limits."""
    inputs: Matrix
    """(3, INPUTS) units per input: attitude [1/rad], integral [1/rad], rate error [s/rad], changes
    of the gyro [s/rad], commands [1/(N*m)]."""
    lead: Matrix
    """(3,) [1/s] rate that an attitude error commands: of the rate limit and of the integral of `g + lead e`."""
    rate_limit: float
    """[rad/s] to which the commanded rate is shortened."""
    dt: float
    """[s] sample time."""


def policy_units(vehicle: Vehicle, teacher: Sequence[GeometricGains]) -> PolicyUnits:
    """Return the scales of a vehicle's policy."""
    scenario = tuning_scenario()
    time = vehicle.actuator_lag + scenario.delay_samples * scenario.dt
    rows = []
    for J, limit in zip(vehicle.inertia_B, vehicle.torque_limit, strict=True):
        full = limit / J
        slopes = [1.0 / (full * scenario.dt)] * SLOPES
        rows.append([1.0 / (full * time**2)] * 2 + [1.0 / (full * time)] + slopes + [1.0 / limit] * COMMANDS)
    return PolicyUnits(
        torque=np.array(vehicle.torque_limit),
        inputs=np.array(rows),
        lead=np.array([gains.attitude / gains.rate for gains in teacher]),
        rate_limit=vehicle.stabilizer.rate_limit,
        dt=scenario.dt,
    )


class Policy:
    """The policy in flight, from level at rest."""

    def __init__(self, weights: Weights, units: PolicyUnits) -> None:
        self._first = weights.first * units.inputs[:, :, None]
        self._second, self._last = weights.second, weights.last * units.torque[:, None, None]
        self._lead: Vector = as_vector(units.lead)
        self._limit: Vector = as_vector(units.torque)
        self._rate_limit, self._dt = units.rate_limit, units.dt
        self._attitude = HeldAttitude()
        self.reset()

    def reset(self) -> None:
        """Return to level, at rest."""
        self._attitude.reset()
        self._integral = self._rate = _ZERO
        self._inputs = np.zeros((3, 1, INPUTS))

    def step(self, gyro: Iterable[float], reference: Iterable[float], force: Iterable[float], dt: float) -> Vector:
        """Return the torque [N*m] B for a gyro sample [rad/s]; the specific force is not read.

        Raises
        ------
        ValueError
            If `dt` [s] is not the sample time of the training.
        """
        if dt != self._dt:
            raise ValueError(f"the policy is trained for samples of {self._dt} s, not {dt}")
        rate = as_vector(gyro)
        e1, e2, e3 = rotation_vector(*self._attitude.update(rate, as_vector(reference), dt))
        a, b, c = self._lead
        s1, s2, s3 = shorten((a * e1, b * e2, c * e3), self._rate_limit)
        i1, i2, i3 = self._integral
        x = self._inputs
        p, q, r = rate
        x[:, 0, 4 : 3 + SLOPES] = x[:, 0, 3 : 2 + SLOPES]
        p0, q0, r0 = self._rate
        self._rate = rate
        x[:, 0, :4] = (s1 / a, i1, p + s1, p - p0), (s2 / b, i2, q + s2, q - q0), (s3 / c, i3, r + s3, r - r0)
        u1, u2, u3 = (np.tanh(np.tanh(x @ self._first) @ self._second) @ self._last)[:, 0, 0].tolist()
        L, M, N = self._limit
        v1, v2, v3 = min(max(u1, -L), L), min(max(u2, -M), M), min(max(u3, -N), N)
        # an axis at its limit integrates no further
        self._integral = (
            i1 + dt * (p + s1) if u1 == v1 else i1,
            i2 + dt * (q + s2) if u2 == v2 else i2,
            i3 + dt * (r + s3) if u3 == v3 else i3,
        )
        x[:, 0, 4 + SLOPES :] = x[:, 0, 3 + SLOPES : -1]
        x[:, 0, 3 + SLOPES] = v1, v2, v3
        return v1, v2, v3


def policy_axis(gains: Matrix, lead: float, dt: float) -> AxisLaw:
    """Return one axis near level from its gains (INPUTS,) [N*m] per input in SI units.

    States are attitude [rad] and rate [rad/s] a sample ago, older changes of the rate [rad/s], integral [rad] and
    commands before [N*m].
    """
    n = 2 + SLOPES - 1 + 1 + COMMANDS
    rows = np.eye(n, n + 2)
    E, omega, slopes, integral, commands = rows[0], rows[1], rows[2 : SLOPES + 1], rows[SLOPES + 1], rows[SLOPES + 2 :]
    rate = np.eye(n + 2)[n]
    attitude, slope = E + 0.5 * dt * (omega + rate), rate - omega
    error = rate + lead * attitude
    command = gains @ np.vstack([attitude, integral, error, slope, slopes, commands])
    step = np.vstack([attitude, rate, slope, slopes[:-1], integral + dt * error, command, commands[:-1]])
    none = np.zeros((n, 1))
    return AxisLaw(A=step[:, :n], B=step[:, n:], C=command[None, :n], D=command[None, n:], G=none, H=none)


@dataclass(frozen=True, slots=True, kw_only=True)
class Training:
    """Length and strength of the training."""

    batches: int = 3000
    """Steps of Adam."""
    batch: int = 256
    """Drawn histories a step."""
    learning_rate: float = 3e-3
    """[-] of Adam, falling to a tenth."""
    generations: int = 120
    """Steps of the evolution strategy."""
    pairs: int = 8
    """Antithetic pairs a generation."""
    spread: float = 0.01
    """[-] perturbation in units of each layer's rms weight."""
    stride: float = 0.12
    """[-] length of a generation's step, in the same units, falling to a tenth."""
    seed: int = 1
    """Seed of everything drawn."""


TRAINING = Training()
"""The training of the shipped weights."""


def teacher_gains(gains: GeometricGains, inertia: float, dt: float) -> Matrix:
    """Return the policy's gains (INPUTS,) [N*m] per input in SI units that equal the teacher's law of an axis.

    The filter on the teacher's derivative, of pole `a`, is in its command before: `u - a u_before` has no filter.
    Attitude and integral before are those now without the last step.
    """
    share = -math.expm1(-2.0 * math.pi * gains.cutoff * dt)
    a, lead, slope = 1.0 - share, gains.attitude / gains.rate, gains.acceleration * share / dt
    before = a * (gains.integral * dt * lead - gains.attitude)  # of the attitude a sample ago
    found = np.zeros(INPUTS)
    found[0], found[1] = gains.attitude + before, gains.integral * (1.0 - a)
    now = gains.rate + slope - 0.5 * dt * before
    ago = -a * gains.rate - slope + a * gains.integral * dt - 0.5 * dt * before
    found[2], found[3] = now + ago, -ago
    found[0] -= lead * found[2]
    found *= -inertia
    found[3 + SLOPES] = a
    return found


def train_policy(vehicle: Vehicle, training: Training = TRAINING) -> Weights:
    """Return the weights that are learned for a vehicle, rounded to float32; some thirty seconds.

    Raises
    ------
    DesignError
        If the teacher can't be tuned, or no weights within the price are found.
    """
    teacher = find_lead(vehicle)
    units = policy_units(vehicle, teacher)
    wanted = [teacher_gains(g, J, units.dt) for g, J in zip(teacher, vehicle.inertia_B, strict=True)]
    scaled = np.array(wanted) / (units.inputs * units.torque[:, None])
    shapes, rng = ((3, INPUTS, UNITS), (3, UNITS, UNITS), (3, UNITS, 1)), np.random.default_rng(training.seed)
    first, second, last = (rng.normal(size=shape) / math.sqrt(shape[1]) for shape in shapes)
    start, short = Weights(_SMALL * first, second, last), replace(training, batches=training.batches // 3)
    weights = _imitate(start, _Histories(vehicle, teacher, units, scaled), short)
    models, limits = tuning_models(vehicle), tuning_limits(vehicle)
    laws = [geometric_axis(g, J, units.dt) for g, J in zip(teacher, vehicle.inertia_B, strict=True)]
    slews = [axis_performance(axis[0], law).slew for axis, law in zip(models, laws, strict=True)]
    room = limits.slew / math.sqrt(sum(slew**2 for slew in slews) / 3.0)
    evolved = [
        _evolve(
            [layer[axis] for layer in weights],
            _Price(models[axis], replace(limits, slew=room * slews[axis]), units, axis),
            training,
        )
        for axis in range(3)
    ]
    weights = Weights(*(np.array(layers) for layers in zip(*evolved, strict=True)))
    weights = _imitate(weights, _Histories(vehicle, teacher, units, weights.gains), training)
    return Weights(*map(_round, weights))


@dataclass(frozen=True, slots=True, eq=False)
class _Histories:
    """Motions from small to beyond full torque, to imitate gains on."""

    vehicle: Vehicle
    """Vehicle."""
    teacher: Sequence[GeometricGains]
    """Teacher, whose gains tell how large inputs become."""
    units: PolicyUnits
    """Scales of the inputs."""
    gains: Matrix
    """(3, INPUTS) [-] gains to imitate, in those scales."""

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Matrix, Matrix]:
        """Return inputs (3, count, INPUTS) and their sizes (1, count, 1)."""
        units, half = self.units, count // 2
        size = np.exp(rng.uniform(math.log(1e-3), math.log(3.0), (1, count, 1)))
        full = np.array(self.vehicle.torque_limit) / np.array(self.vehicle.inertia_B)
        largest = units.rate_limit / units.lead
        held = np.minimum(full / np.array([gains.integral for gains in self.teacher]), largest)
        e, i, rate, slope, command = (
            size * unit[:, None, None] * rng.normal(size=(3, count, 1))
            for unit in (largest, held, np.full(3, units.rate_limit), full, units.torque)
        )
        e = np.clip(e, -largest[:, None, None], largest[:, None, None])
        noise = 0.01 * units.rate_limit * size * rng.normal(size=(3, count, SLOPES))
        torque = units.torque[:, None, None]
        commands = np.clip(command + 0.1 * torque * size * rng.normal(size=(3, count, COMMANDS)), -torque, torque)
        x = np.concatenate([e, i, rate, slope * units.dt + noise, commands], axis=2) * units.inputs[:, None, :]
        # half of them are where the torque turns from one direction to the other: brakings are learned there
        asked = size[:, :half, 0] * rng.normal(size=(3, half))
        x[:, :half, 2] += (asked - (x[:, :half] @ self.gains[:, :, None])[..., 0]) / self.gains[:, None, 2]
        return x, size


def _imitate(weights: Weights, histories: _Histories, training: Training) -> Weights:
    """Return weights that fit clipped gains on drawn histories, by Adam; near level the gains are met exactly."""
    rng = np.random.default_rng(training.seed)
    layers = [layer.copy() for layer in weights]
    mean, square = ([np.zeros(layer.shape) for layer in layers] for _ in range(2))
    for number in range(1, training.batches + 1):
        x, size = histories.draw(training.batch, rng)
        target = np.clip(x @ histories.gains[:, :, None], -_CLIPPED, _CLIPPED)
        norm = np.minimum(_CLIPPED, size) + 1e-4
        first = np.tanh(x @ layers[0])
        second = np.tanh(first @ layers[1])
        slope = (second @ layers[2] - target) / norm**2 / training.batch
        back = (slope @ layers[2].mT) * (1.0 - second**2)
        gradients = (x.mT @ ((back @ layers[1].mT) * (1.0 - first**2)), first.mT @ back, second.mT @ slope)
        rate = training.learning_rate * 0.1 ** (number / training.batches)
        for k, gradient in enumerate(gradients):
            mean[k] = 0.9 * mean[k] + 0.1 * gradient
            square[k] = 0.999 * square[k] + 0.001 * gradient**2
            unbiased = np.sqrt(square[k] / (1.0 - 0.999**number)) + 1e-8
            layers[k] -= rate * mean[k] / (1.0 - 0.9**number) / unbiased
    return _calibrate(Weights(*layers), histories.gains)


def _round(layer: Matrix) -> Matrix:
    return layer.astype(np.float32).astype(float)


def _calibrate(weights: Weights, scaled: Matrix) -> Weights:
    """Return the weights with the least change of the last layer that makes the gains at level `scaled`."""
    through = weights.first @ weights.second
    missing = scaled[:, :, None] - through @ weights.last
    return weights._replace(last=weights.last + np.linalg.pinv(through) @ missing)


class _Price:
    """Cost of one axis: its error in turbulence, and penalties beyond the price."""

    def __init__(self, models: AxisModels, limits: TuningLimits, units: PolicyUnits, axis: int) -> None:
        self._model, self._limits, self._dt = models[0], limits, units.dt
        self._units, self._lead = units.inputs[axis] * units.torque[axis], float(units.lead[axis])
        self._omega = np.geomspace(1.0, 0.999 * math.pi / units.dt, 120)
        late = np.exp(-1j * self._omega * units.dt * models[0].delay_samples)
        self._plants = np.array([model.plant.response(self._omega)[:, 0, 0] * late for model in models])
        self._peaks = np.array([limits.sensitivity_peak] + [limits.corner_peak] * (len(models) - 1))

    def cost(self, layers: Sequence[Matrix]) -> tuple[float, float]:
        """Return the logarithm of the error [rad], and by how much the price is exceeded, as a logarithm; 0 if met."""
        gains = (layers[0] @ layers[1] @ layers[2])[:, 0] * self._units
        controller = policy_axis(gains, self._lead, self._dt).controller(self._dt)
        with np.errstate(all="ignore"):
            try:
                error, slew = rms(self._model, controller)
            except ValueError:
                return _UNSTABLE, _UNSTABLE
            differences = np.abs(1.0 - controller.response(self._omega)[:, 0, 0] * self._plants)
            peaks = 1.0 / differences.min(axis=1) / (self._peaks * (1.0 - _GRID_MARGIN))
        if not (error < 1.0 and math.isfinite(slew)):
            return _UNSTABLE, _UNSTABLE
        excess = [math.log(peak) for peak in peaks.tolist()] + [math.log(slew / self._limits.slew) - _ROUNDING]
        return math.log(error), sum(max(each, 0.0) for each in excess)


def _climb(layers: list[Matrix], price: _Price, training: Training, rng: np.random.Generator) -> list[Matrix]:
    """Return the direction in which the weights' cost rises, by antithetic pairs."""
    scales = [math.sqrt(float(np.mean(layer**2))) for layer in layers]

    def cost(draw: list[Matrix], sign: float) -> float:
        error, excess = price.cost([layer + sign * training.spread * d for layer, d in zip(layers, draw, strict=True)])
        return error + _PENALTY * excess

    draws = [
        [rng.normal(size=layer.shape) * scale for layer, scale in zip(layers, scales, strict=True)]
        for _ in range(training.pairs)
    ]
    differences = np.array([cost(draw, 1.0) - cost(draw, -1.0) for draw in draws])
    shares = differences / (np.linalg.norm(differences) or 1.0)
    return [np.tensordot(shares, np.array(own), 1) for own in zip(*draws, strict=True)]


def _evolve(layers: list[Matrix], price: _Price, training: Training) -> list[Matrix]:
    """Return the weights of one axis after the evolution strategy.

    Raises
    ------
    DesignError
        If none within the price are found.
    """
    rng = np.random.default_rng(training.seed)
    best, least = None, math.inf
    for generation in range(training.generations + 1):
        rounded = [_round(layer) for layer in layers]
        error, excess = price.cost(rounded)
        if excess == 0.0 and error < least:
            best, least = rounded, error
        step = _climb(layers, price, training, rng)
        stride = training.stride * 0.1 ** (generation / max(training.generations, 1))
        layers = [layer - stride * s for layer, s in zip(layers, step, strict=True)]
    if best is None:
        raise DesignError("policy: the evolution strategy finds no weights within the price")
    return best


def load_weights(name: str) -> Weights:
    """Return the shipped weights of a vehicle."""
    with np.load(DATA / "policy.npz") as arrays:
        return Weights(*(arrays[f"{name}.{layer}"].astype(float) for layer in Weights._fields))


@cache
def _train(vehicle: Vehicle) -> Weights:
    return train_policy(vehicle)


def make(vehicle: Vehicle) -> Policy:
    """Return the policy for a vehicle; one that is not shipped is trained first, in some thirty seconds."""
    vehicle = design_vehicle(vehicle)
    weights = load_weights(_TWINS[vehicle.name]) if is_shipped(vehicle) else _train(vehicle)
    return Policy(weights, policy_units(vehicle, find_lead(vehicle)))
