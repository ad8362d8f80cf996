"""Certificates and their assumptions on a terminal."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from gustproof.cli.failures import ExitStatus, say
from gustproof.cli.options import print_json

if TYPE_CHECKING:
    from gustproof.prove.boundedness import FlightCertificate
    from gustproof.robust.gain.certificate import Certificate

_ASSUMPTIONS = {
    "leak_per_s": "leak [1/s]",
    "rate_damping_per_s": "rate damping [1/s]",
    "angle_rad": "angles up to [rad]",
    "rate_rad_s": "rates up to [rad/s]",
    "sample_time_s": "sample time [s]",
    "vehicle": "vehicle",
    "law_made_for": "law is made for",
    "law_sha256": "SHA-256 of law file",
    "vehicle_sha256": "SHA-256 of vehicle",
    "scenario_sha256": "SHA-256 of scenario",
    "air": "wind",
    "moment_N_m": "moment up to [N m]",
    "moment_asked_N_m": "moment asked [N m]",
    "moment_between_samples": "moment in a sample",
    "moment_slope_N_m_s": "slope in it [N m/s]",
    "noise_rad_s": "gyro noise rms [rad/s]",
    "inertia_kg_m2": "inertia [kg m^2]",
    "actuator_lag_s": "actuator lag [s]",
    "system_sha256": "SHA-256 of the system",
    "speeds_per_s": "speeds up to [1/s]",
    "inertia_spread": "inertia within share",
    "actuator_lag_spread": "lag within share",
    "rho": "attitude and rates",
    "horizon_s": "duration [s]",
    "delay_samples": "delay [samples]",
    "delay_s": "delay [s]",
    "noise_probability": "risk from noise",
    "noise_period_s": "risk counts over [s]",
    "wind_20ft_m_s": "wind at 20 ft [m/s]",
    "airspeed_m_s": "it passes at [m/s]",
    "altitude_m": "altitude [m]",
    "gust_scale": "factor on gusts",
    "not_covered": "in the file, NOT covered",
}
"""Label of each assumption on a terminal; others keep their key."""
_UNBOUNDED = {
    "horizon_s": "unlimited",
    "delay_samples": "none",
    "inertia_spread": "none: the nominal inertia",
    "actuator_lag_spread": "none: the nominal lag",
    "noise_rad_s": "none",
    "law_made_for": "no named vehicle",
}
"""Text of an assumption that is `None` or 0."""
_IDLE = {"moment_slope_N_m_s", "moment_asked_N_m", "noise_probability", "noise_period_s", "not_covered"}
"""Assumptions that are left out where they are `None`, 0 or empty."""


def leave_with(*, is_whole: bool) -> None:
    """End the command with the exit status of a proof: 0 if all that was asked is proved, 1 if not.

    Raises
    ------
    typer.Exit
        Always.
    """
    raise typer.Exit((ExitStatus.DONE if is_whole else ExitStatus.REQUIREMENT_FAILED).value)


def show_certificate(
    name: str, vehicle: str, certificate: "Certificate | FlightCertificate", output: Path | None, *, as_json: bool
) -> None:
    """Print verdict, bounds and assumptions of a certificate, and where it is."""
    from gustproof.prove.boundedness import FlightCertificate

    if as_json:
        figures: dict[str, Any] = {"proven": certificate.is_whole, "vehicle": vehicle}
        if isinstance(certificate, FlightCertificate):
            figures |= {
                "part": certificate.certified_fraction,
                "estimate_deg": certificate.estimate_deg,
                "truth_deg": certificate.truth_deg,
                "torque_nm": certificate.torque_nm,
                "moment_class": certificate.moment_class.value,
            }
        else:
            figures |= {"gain": certificate.gain, "lower_bound": certificate.lower_bound}
        print_json({**figures, "assumes": certificate.assumes, "statement": certificate.statement})
        return
    if isinstance(certificate, FlightCertificate):
        _show_flight(f"{name} on {vehicle}", certificate)
    else:
        say(f"{name} on {vehicle}: {'proven' if certificate.proven else 'NOT proven'}: {certificate.claim}")
        print(_describe_lower_bound(certificate))
    show_assumptions({"vehicle": vehicle, **certificate.assumes})
    if output is not None:
        print(
            f"certificate in {output}"
            if certificate.proven
            else "no certificate is written: there is no proof to check"
        )


def _show_flight(subject: str, certificate: "FlightCertificate") -> None:
    """Print the verdict on a flight, its bounds a line each, and the judge's sentence."""
    from gustproof.checker.directed_rounding import list_up, print_down

    if not certificate.proven:
        say(f"{subject}: {certificate.verdict}: {certificate.claim}")
        return
    say(f"{subject}: {certificate.verdict}")
    horizon = certificate.assumes["horizon_s"]
    limited = "for ever" if horizon is None else f"{print_down(horizon)} s"
    own = "for ever" if certificate.certified_fraction is not None else limited
    if certificate.truth_deg is not None:
        truth = [value for value in certificate.truth_deg if value is not None]
        true = f"true attitude, {limited}" if len(truth) == 3 else "true roll and pitch, for ever"
        say(f"  {true:30} <= {list_up(truth)} deg")
    say(f"  {'attitude by the law, ' + own:30} <= {list_up(certificate.estimate_deg or [])} deg")
    say(f"  {'torque':30} <= {list_up(certificate.torque_nm or [])} N m")
    say(f"in words: {certificate.claim}")


def _describe_lower_bound(certificate: "Certificate") -> str:
    from gustproof.checker.directed_rounding import print_down, print_up

    reached, gain = certificate.lower_bound, certificate.gain
    constrained = certificate.evidence.get("kind") == "constrained gain"
    line = f"a simulation{' or a linear member' if constrained else ''} reached {print_down(reached, 4)}"
    return f"{line}, so the claimed bound {print_up(gain)} is false" if gain is not None and reached > gain else line


def show_assumptions(assumes: dict[str, Any]) -> None:
    """Print the assumptions of a statement, a line each."""
    print("assumptions")
    for key, value in assumes.items():
        if key in _IDLE and not value:
            continue
        unbounded = key in _UNBOUNDED and value in (None, 0)
        text = _UNBOUNDED[key] if unbounded else "none" if value is None else _shorten(value)
        say(f"  {_ASSUMPTIONS.get(key, key):24} {', '.join(value) if key == 'not_covered' else text}")


def _shorten(value: Any) -> Any:
    """Return numbers in four digits, rounded down as assumptions are; the certificate has all of them."""
    from gustproof.checker.directed_rounding import print_down

    if isinstance(value, float):
        return print_down(value, 4)
    if isinstance(value, list | tuple) and all(each is None or isinstance(each, float) for each in value):
        return ", ".join("any" if each is None else print_down(each, 4) for each in value)
    return value
