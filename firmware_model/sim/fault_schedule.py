"""Apply the events of a scenario to the plant, in order of time."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from pydantic import ValidationError

from firmware_model.config import events
from firmware_model.config.scenario import Scenario
from firmware_model.config.validation import format_errors
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.physics.actuators import ActuatorParams
from firmware_model.types import Vector

_NO_DRIFT = (0.0, 0.0, 0.0)


class ChangingVehicle(NamedTuple):
    """Quantities that events change."""

    vehicle: Vehicle
    """Vehicle with its gyro."""
    bias: Vector
    """[rad/s] B, addition to the vehicle's gyro bias."""
    drift: Vector
    """[rad/s^2] B, growth of that addition."""
    since_s: float
    """[s] start of the growth."""
    noise: float
    """[-] factor on the gyro's noise."""
    actuators: ActuatorParams
    """Effectiveness and limits, units beside each number."""
    health: tuple[float, ...]
    """[-] (n,) thrust of each rotor, of what it is to give."""


def initial_plant(vehicle: Vehicle, scenario: Scenario) -> ChangingVehicle:
    """Return the plant before any event."""
    health = (1.0,) * vehicle.rotors.count
    return ChangingVehicle(
        vehicle, scenario.gyro.bias_rad_s, _NO_DRIFT, 0.0, float(scenario.gyro.noise), ActuatorParams(), health
    )


def fault_schedule(vehicle: Vehicle, scenario: Scenario) -> Iterator[tuple[int, ChangingVehicle]]:
    """Yield the plant after each event with the sample of that event, in order of time.

    Raises
    ------
    ConfigError
        If a payload makes the vehicle invalid, or it has no such rotor.
    """
    plant = initial_plant(vehicle, scenario)
    changes: list[tuple[float, events.PlantEvent, bool]] = [
        (event.at_s, event, False) for event in scenario.plant_events
    ]
    changes += [
        (e.at_s + e.over_s, e, True) for e in scenario.plant_events if isinstance(e, events.GyroBias) and e.over_s
    ]
    for at_s, event, is_end in sorted(changes, key=lambda change: change[0]):
        plant = _end_drift(plant, event) if is_end else _apply_event(plant, event)
        yield scenario.sample_at(at_s), plant


def _end_drift(plant: ChangingVehicle, event: events.PlantEvent) -> ChangingVehicle:
    return (
        plant._replace(bias=event.bias_rad_s, drift=_NO_DRIFT, since_s=0.0)
        if isinstance(event, events.GyroBias)
        else plant
    )


def _apply_event(plant: ChangingVehicle, event: events.PlantEvent) -> ChangingVehicle:
    vehicle = plant.vehicle
    match event:
        case events.GyroBias():
            if not event.over_s:
                return _end_drift(plant, event)
            p, q, r = ((b - a) / event.over_s for a, b in zip(plant.bias, event.bias_rad_s, strict=True))
            return plant._replace(drift=(p, q, r), since_s=event.at_s)
        case events.GyroNoise():
            return plant._replace(noise=event.factor)
        case events.GyroRange():
            return plant._replace(vehicle=replace(vehicle, gyro=replace(vehicle.gyro, range=event.range_rad_s)))
        case events.ActuatorEffect():
            return plant._replace(actuators=plant.actuators._replace(share=event.share))
        case events.ActuatorLag():
            return plant._replace(vehicle=replace(vehicle, actuator_lag=event.lag_s))
        case events.ActuatorLimit():
            return plant._replace(actuators=plant.actuators._replace(limit=event.torque_limit_nm))
        case events.Payload():
            return plant._replace(vehicle=_add_payload(vehicle, event))
        case events.RotorFailure():
            return plant._replace(health=_fail_rotor(plant, event))
    return plant


def _add_payload(vehicle: Vehicle, event: events.Payload) -> Vehicle:
    gains = zip(vehicle.inertia_B, event.inertia_share, event.inertia_kgm2, strict=True)
    I_x, I_y, I_z = (before * (1.0 + share) + gain for before, share, gain in gains)
    mass = vehicle.mass * (1.0 + event.mass_share) + event.mass_kg
    try:
        return replace(vehicle, mass=mass, inertia_B=(I_x, I_y, I_z))
    except ValidationError as error:
        mistakes = format_errors(Vehicle, error.errors())
        loaded = f"vehicle '{vehicle.name}' of {vehicle.mass:g} kg can't be with {mass - vehicle.mass:+g} kg"
        raise ConfigError(f"event 'payload' at {event.at_s} s: {loaded}: {mistakes}") from None


def _fail_rotor(plant: ChangingVehicle, event: events.RotorFailure) -> tuple[float, ...]:
    vehicle, health = plant.vehicle, list(plant.health)
    if event.rotor > len(health):
        raise ConfigError(f"event 'rotor_failure': vehicle '{vehicle.name}' has {len(health)} rotors, no {event.rotor}")
    health[event.rotor - 1] = event.share
    return tuple(health)
