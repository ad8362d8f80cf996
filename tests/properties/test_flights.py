"""Any legal flight is physics: attitudes of length 1, nobody below the ground, or "diverged" by name."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.config.events import (
    ActuatorEffect,
    ActuatorLag,
    ActuatorLimit,
    AttitudeReference,
    GyroBias,
    GyroNoise,
    GyroRange,
    Payload,
    RotorFailure,
)
from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.config.waveforms import GustStep
from gustproof.flight.routes.direct import fly_direct
from gustproof.flight.routes.upsets import divergence_s
from gustproof.law.form import load_law

LAW = load_law("flagship")
VEHICLES = [load_vehicle(name) for name in ("paper", "iris", "octo")]
STEPS = 250
DURATION_S = 1.0


def draw_vehicle(random):
    """Return a shipped vehicle scaled to a mass of 30 g to 500 kg, its shape and its actuators changed."""
    vehicle = VEHICLES[random.integers(3)]
    mass = float(np.exp(random.uniform(np.log(0.03), np.log(500.0))))
    heavier = mass / vehicle.mass
    longer = heavier ** (1.0 / 3.0)
    rotors, gear = vehicle.rotors, vehicle.gear
    size = {name: longer * getattr(gear, name) for name in ("half_length", "half_width", "height", "sag")}
    return replace(
        vehicle,
        mass=mass,
        inertia_B=tuple(row * heavier * longer**2 for row in vehicle.inertia_B),
        actuator_lag=float(10.0 ** random.uniform(-3.0, 0.0)),
        torque_limit=tuple(row * heavier * longer * random.uniform(0.3, 3.0) for row in vehicle.torque_limit),
        span=longer * vehicle.span,
        gust_gain=longer**3 * vehicle.gust_gain,
        drag_area=longer**2 * vehicle.drag_area,
        rotors=replace(
            rotors,
            position_B=tuple(tuple(longer * each for each in place) for place in rotors.position_B),
            thrust_max=heavier * rotors.thrust_max * random.uniform(1.3, 3.0),
            drag_ratio=longer * rotors.drag_ratio,
        ),
        gear=replace(gear, **size),
    )


def draw_scenario(random, *, free):
    """Return a scenario of a storm, up to four events, and any delay, height and attitude that a file may ask for."""

    def share(count=3):
        return tuple(random.uniform(0.0, 1.0, count).tolist())

    def at_s():
        return random.integers(10, STEPS - 10) / STEPS

    events = [
        AttitudeReference(kind="attitude", at_s=at_s(), euler_deg=tuple(random.uniform(-1, 1, 3) * (180, 90, 400))),
        GyroBias(kind="gyro_bias", at_s=at_s(), bias_rad_s=tuple(random.uniform(-3.0, 3.0, 3))),
        GyroNoise(kind="gyro_noise", at_s=at_s(), factor=10.0 ** random.uniform(-1.0, 4.0)),
        GyroRange(kind="gyro_range", at_s=at_s(), range_rad_s=10.0 ** random.uniform(-3.0, 1.0)),
        ActuatorEffect(kind="actuator_effect", at_s=at_s(), share=share()),
        ActuatorLag(kind="actuator_lag", at_s=at_s(), lag_s=10.0 ** random.uniform(-3.0, 1.0)),
        ActuatorLimit(kind="actuator_limit", at_s=at_s(), torque_limit_nm=tuple(10.0 ** random.uniform(-4.0, 0.0, 3))),
        Payload(
            kind="payload", at_s=at_s(), mass_share=(more := random.uniform(-0.6, 0.4)), inertia_share=(0.3 * more,) * 3
        ),
        *([RotorFailure(kind="rotor_failure", at_s=at_s(), rotor=int(random.integers(1, 5)))] if free else []),
    ]
    chosen = random.permutation(len(events))[: random.integers(0, 5)]
    storm = GustStep(kind="step", speed_mps=random.uniform(0.0, 60.0), from_deg=random.uniform(0.0, 360.0), start_s=0.1)
    attitude = (0.0, 0.0, 0.0) if free else tuple(random.uniform(-1.0, 1.0, 3) * (180.0, 90.0, 180.0))
    return replace(
        load_scenario("paper-turbulence"),
        duration_s=DURATION_S,
        translation="free" if free else "held",
        altitude_m=float(10.0 ** random.uniform(-1.3, 2.4)),
        delay_samples=int(random.integers(0, 13)),
        initial_attitude_deg=attitude,
        wind=(storm, *load_scenario("paper-turbulence").wind),
        event=tuple(events[i] for i in sorted(chosen, key=lambda i: events[i].at_s)),
    )


@pytest.mark.parametrize("free", [False, True])
def test_any_legal_flight_is_finite_and_above_the_ground_or_named(free):
    beyond = 0
    for seed in range(100):
        random = np.random.default_rng((seed, free))
        vehicle, scenario = draw_vehicle(random), draw_scenario(random, free=free)
        with np.errstate(all="ignore"):
            records = fly_direct(scenario, LAW, vehicle=vehicle, seed=seed)
        if (end_s := divergence_s(records, scenario)) is not None:
            beyond += 1
            records = records[records["time_us"] < 1e6 * end_s]
        assert np.allclose(np.linalg.norm(records["q_NB"], axis=1), 1.0, rtol=0.0, atol=1e-6), seed
        for name in ("omega_B", "velocity_N", "position_N"):
            assert np.isfinite(records[name]).all(), (seed, name)
        if free:
            assert records["position_N"][:, 2].max() <= vehicle.gear.height + 1.0, seed
    assert beyond < 10
