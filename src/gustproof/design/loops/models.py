"""PX4's and ArduPilot's own loops as laws: from their parameters, or from a file of theirs.

A law commands torque on the vehicle's rotors, by the scale of the autopilot's mixer. Its attitude is the gyro's
strapdown: errors of the autopilot's estimator are not in it.

Filters are built for the law's rate, as an autopilot builds its own for that of its samples. For a scenario of another
rate ask for a law of that rate; such a law is not resampled.
"""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from firmware_model.config.files import PARAMETER_SUFFIXES, tell_kind
from firmware_model.config.firmware import is_measured
from firmware_model.config.parameter_files import is_parameter_file, read_parameters
from firmware_model.config.scenario import sample_time
from firmware_model.config.validation import none_of
from firmware_model.config.vehicle import Vehicle
from firmware_model.errors import ConfigError
from firmware_model.types import Vector
from gustproof.design.loops.ardupilot_loops import ARDUPILOT
from gustproof.design.loops.px4_loops import PX4
from gustproof.design.loops.settings import AutopilotLoops, LoopSignals, complete, describe_defaults, drop_fractions
from gustproof.law.cascade import AxisLaw, cascade_law
from gustproof.law.form import Law, Provenance

AUTOPILOTS: Mapping[str, AutopilotLoops] = {"px4": PX4, "ardupilot": ARDUPILOT}
"""Loops by the names of `--autopilot`."""
_FREE_RATE = 100.0
"""[rad/s] limit of an axis without one beside an axis that has one: no gyro measures so much."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotLaw:
    """Loops of an autopilot as a law.

    Examples
    --------
    >>> from gustproof import load_vehicle
    >>> from gustproof.design.loops.models import autopilot_law
    >>> stock = autopilot_law("px4", {}, load_vehicle("paper"))
    >>> (stock.law.name, stock.rate_hz)
    ('px4', 250)
    """

    law: Law
    """Torque law; its provenance has all parameters of the loops."""
    rate_hz: int
    """[Hz] rate of the law."""
    thrust_step: float
    """[N] step to which a rotor's thrust is rounded; 0 if it is not rounded. See `airframe.output_rounding`."""
    remarks: tuple[str, ...]
    """Parts of the loops that the law's form does not hold, a line each."""


def autopilot_law(
    kind: str,
    parameters: Mapping[str, float],
    vehicle: Vehicle,
    *,
    rate_hz: int | None = None,
    full_torque: Vector | None = None,
    name: str = "",
) -> AutopilotLaw:
    """Return the loops of `px4` or `ardupilot` on a vehicle; those not given are the autopilot's defaults.

    By default the rate is that of the parameters, else that of the autopilot's simulation, 250 and 400 Hz.
    `full_torque` [N*m], that of a command of 1, is by default what a log measured, or that of its mixer.

    Raises
    ------
    ConfigError
        If the autopilot is unknown, a value is out of range, or neither a log nor a mixer tells the torque of its
        commands.
    """
    autopilot = AUTOPILOTS.get(kind)
    if autopilot is None:
        raise ConfigError(f"autopilot {none_of(kind, tuple(AUTOPILOTS))}")
    values, (rate, remark) = complete(autopilot, parameters), autopilot.find_rate(parameters)
    if rate_hz is not None and rate_hz != rate:
        rate, remark = rate_hz, f"{autopilot.loop_rate[0]}: the loops are taken at {rate_hz} Hz, as is asked for"
    full_torque = autopilot.full_torque(vehicle, values) if full_torque is None else full_torque
    axes = [autopilot.build(axis, values, full_torque[axis], rate) for axis in range(3)]
    law = cascade_law(
        name or kind,
        _match(axes),
        vehicle,
        sample_time(rate),
        Provenance.of(
            vehicle,
            f"loops of {autopilot.name}, {autopilot.version}, at {rate} Hz",
            values | {autopilot.loop_rate[0]: rate},
        ),
    )
    return AutopilotLaw(
        law=law,
        rate_hz=rate,
        thrust_step=autopilot.thrust_step(vehicle),
        remarks=(
            *_strange(autopilot, parameters),
            *_describe_command(vehicle),
            *_describe_frame(autopilot, parameters, vehicle),
            *describe_defaults(autopilot, parameters),
            remark,
            *autopilot.remarks(parameters, rate),
        ),
    )


def is_own_loop(law: Law) -> bool:
    """Return whether a law is the loops of an autopilot."""
    return any(autopilot.loop_rate[0] in law.provenance.parameters for autopilot in AUTOPILOTS.values())


def read_autopilot_law(
    path: Path, vehicle: Vehicle, *, rate_hz: int | None = None, over: Mapping[str, float] = MappingProxyType({})
) -> AutopilotLaw:
    """Return the loops of a parameter file, .params of QGroundControl or .param of ArduPilot, found by its names.

    It is loaded `over` other parameters of that autopilot.

    Raises
    ------
    ConfigError
        If there is no such file, it is not of one of these autopilots, or see `autopilot_law`.
    """
    if not is_parameter_file(path):
        raise ConfigError(f"{path}: a parameter file ends in {', '.join(PARAMETER_SUFFIXES)}{tell_kind(path)}")
    found: list[str] = []
    parameters = {name: float(value) for name, value in read_parameters(str(path), "", found).items()}
    if wrong := [name for name, value in parameters.items() if not math.isfinite(value)]:
        raise ConfigError(f"{path}: {wrong[0]} is not finite")
    kinds = _find_kinds(parameters)
    if len(kinds) != 1:
        which = "of both PX4 and ArduPilot" if kinds else "of PX4 (MC_…) or ArduPilot (ATC_…)"
        raise ConfigError(f"{path}: must hold gains of one autopilot, there are {'those' if kinds else 'none'} {which}")
    name = "-".join(filter(None, (kinds[0], re.sub(r"[^a-z0-9]+", "-", path.stem.lower()).strip("-"))))
    kept = drop_fractions(AUTOPILOTS[kinds[0]], parameters)
    try:
        AUTOPILOTS[kinds[0]].check_gains(parameters)
        built = autopilot_law(kinds[0], {**over, **kept}, vehicle, rate_hz=rate_hz, name=name)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    return replace(built, remarks=(*found, *_cut(AUTOPILOTS[kinds[0]], parameters, kept), *built.remarks))


def _find_kinds(names: Collection[str]) -> list[str]:
    """Return the autopilots whose names these are; by those of other vehicles only if there are none of multicopters.

    ArduPilot's GND_EFFECT_COMP, which all copters have, looks like a name of PX4's rovers.
    """
    own = [kind for kind, each in AUTOPILOTS.items() if any(name.startswith(each.family) for name in names)]
    return own or [
        kind
        for kind, each in AUTOPILOTS.items()
        if any(re.fullmatch(stranger, name) for name in names for stranger in (*each.strangers, *each.others))
    ]


def _match(axes: Sequence[LoopSignals]) -> list[AxisLaw]:
    """Return laws of one order, all with a limit of the commanded rate or none."""
    order = max(each.loop.order for each in axes)
    limits = [each.limit for each in axes]
    if any(limits):
        limits = [limit or _FREE_RATE for limit in limits]
    return [each.axis_law(order, limit) for each, limit in zip(axes, limits, strict=True)]


def _cut(autopilot: AutopilotLoops, parameters: Mapping[str, float], kept: Mapping[str, float]) -> list[str]:
    return [
        f"{name}: {value:g} is {kept[name]:g}, a whole number in {autopilot.name}"
        for name, value in parameters.items()
        if abs(kept[name] - value) > 1e-6
    ]


def _describe_command(vehicle: Vehicle) -> list[str]:
    """Return remarks on what a log states, or leaves out, about the command; none if the rotors give it."""
    command = vehicle.command
    if command is None or not is_measured(vehicle):
        return []
    limits = ", ".join(f"{limit / row:.3g}" for limit, row in zip(vehicle.torque_limit, vehicle.inertia_B, strict=True))
    found = [f"a command of 1 gives {limits} rad/s^2, {1e3 * command.delay:.3g} ms late, as the log measured"]
    if command.autopilot not in AUTOPILOTS:
        found.append(
            f"the log, of {command.autopilot}, does not tell whose commands it has: taken for this autopilot's"
        )
    if command.unmeasured:
        found.append(f"{' and '.join(command.unmeasured)}: not measured, the torque is a guess from the other axes")
    return found


def _describe_frame(autopilot: AutopilotLoops, parameters: Mapping[str, float], vehicle: Vehicle) -> list[str]:
    """Return a remark if the frame of the parameters has other rotors than the vehicle; none if these are assumed."""
    frame = autopilot.rotors(parameters)
    if frame is None or is_measured(vehicle) or frame[1] == vehicle.rotors.count:
        return []
    return [
        f"{frame[0]} has {frame[1]} rotors: it does not fit vehicle '{vehicle.name}', which has {vehicle.rotors.count}"
    ]


def _strange(autopilot: AutopilotLoops, parameters: Mapping[str, float]) -> list[str]:
    """Return remarks on old spellings, and on names that look as if they were of the loops, if there are such."""
    old = {now: [name for name in parameters if re.fullmatch(names, name)] for names, now in autopilot.renamed.items()}
    found = [
        f"{', '.join(names)}: not read, an old spelling of {now}"
        for now, names in old.items()
        if any(parameters[name] for name in names)  # what is off costs nothing
    ]
    parameters = {name: value for name, value in parameters.items() if not any(name in names for names in old.values())}
    names = [name for name in parameters if name.startswith(autopilot.family) and name not in autopilot.settings]
    names = [name for name in names if not re.fullmatch(autopilot.known, name)]
    return [*found, *([f"not known: {', '.join(names)}"] if names else [])]
