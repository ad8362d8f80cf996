"""Range of inertia and actuator lag that a law is judged over: the spreads of a vehicle file."""

from dataclasses import dataclass, replace
from itertools import product

from firmware_model.config.uncertainty import VehicleSet
from firmware_model.config.vehicle import Vehicle
from firmware_model.types import Vector
from gustproof.robust.uncertain.uncertainty import Spreads
from gustproof.studies.rate.law_margins import SPREADS

_INERTIAS = ("inertia_B.x", "inertia_B.y", "inertia_B.z")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantBox:
    """Vehicles between the ends of inertia and lag, all else nominal."""

    nominal: Vehicle
    """Nominal vehicle."""
    low: Vector
    """[kg*m^2] B, least moments of inertia."""
    high: Vector
    """[kg*m^2] B, largest moments of inertia."""
    lag: tuple[float, float]
    """[s] least and largest actuator lag."""
    assumed: bool
    """True if the vehicle file has neither spread: `SPREADS` are used."""

    def corners(self) -> list[Vehicle]:
        """Return light and heavy vehicles with small and large lag."""
        pairs = product((self.low, self.high), self.lag)
        found = [replace(self.nominal, inertia_B=inertia, actuator_lag=lag) for inertia, lag in pairs]
        return [vehicle for i, vehicle in enumerate(found) if vehicle not in (self.nominal, *found[:i])]

    def centre(self, axis: int) -> tuple[Vehicle, Spreads]:
        """Return the vehicle in the middle, and the spreads about it that give the ends for one axis."""
        x, y, z = (0.5 * (low + high) for low, high in zip(self.low, self.high, strict=True))
        (least, most), (low, high) = self.lag, (self.low[axis], self.high[axis])
        spreads = Spreads(inertia=(high - low) / (high + low), actuator_lag=(most - least) / (most + least))
        return replace(self.nominal, inertia_B=(x, y, z), actuator_lag=0.5 * (least + most)), spreads

    def widest(self) -> Spreads:
        """Return the spreads about the middle that cover all axes."""
        each = [self.centre(axis)[1] for axis in range(3)]
        return Spreads(inertia=max(spread.inertia for spread in each), actuator_lag=each[0].actuator_lag)

    def shares(self) -> Spreads:
        """Return the least spreads about the nominal vehicle that cover all axes."""
        ends = zip(self.low, self.high, self.nominal.inertia_B, strict=True)
        return Spreads(
            inertia=max(_share(*each) for each in ends), actuator_lag=_share(*self.lag, self.nominal.actuator_lag)
        )

    def describe(self) -> str:
        """Return the ends in words."""
        inertia = ", ".join(f"{low:.3g} to {high:.3g}" for low, high in zip(self.low, self.high, strict=True))
        lag = " to ".join(f"{1e3 * value:.3g}" for value in self.lag)
        said = " (assumed: the file has no spreads)" if self.assumed else ""
        return f"inertia {inertia} kg m^2, lag {lag} ms{said}"


def plant_box(vehicles: VehicleSet) -> PlantBox:
    """Return the range in a vehicle file; `SPREADS` about the nominal if it has none of inertia and lag."""
    vehicle, spreads, lags = vehicles.nominal, vehicles.spreads, vehicles.lag_range
    nominal = [*vehicle.inertia_B, vehicle.actuator_lag]
    if assumed := lags is None and not any(name in spreads for name in _INERTIAS):
        shares = [SPREADS.inertia] * 3 + [SPREADS.actuator_lag]
        ends = [((1.0 - share) * value, (1.0 + share) * value) for share, value in zip(shares, nominal, strict=True)]
    else:
        ends = [
            (spreads[name].low, spreads[name].high) if name in spreads else (value, value)
            for name, value in zip(_INERTIAS, vehicle.inertia_B, strict=True)
        ]
        ends.append(lags or (vehicle.actuator_lag, vehicle.actuator_lag))
    x, y, z, lag = ends
    return PlantBox(nominal=vehicle, low=(x[0], y[0], z[0]), high=(x[1], y[1], z[1]), lag=lag, assumed=assumed)


def describe_vehicle(vehicle: Vehicle) -> str:
    """Return inertia and lag in words."""
    inertia = ", ".join(f"{value:.3g}" for value in vehicle.inertia_B)
    return f"inertia {inertia} kg m^2, lag {1e3 * vehicle.actuator_lag:.3g} ms"


def _share(low: float, high: float, nominal: float) -> float:
    return max(high / nominal - 1.0, 1.0 - low / nominal)
