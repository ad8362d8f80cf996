"""Gaps and errors of the paper with the choices made here, printed with the results."""

from dataclasses import replace

from firmware_model.config.scenario import Scenario
from firmware_model.config.vehicle import Vehicle
from firmware_model.config.waveforms import Constant, Dryden, GustCosine, Wind

OpenQuestion = tuple[str, str]
"""A gap or an error of the paper, and the choice made here, with its reason."""

ERRATA: tuple[OpenQuestion, ...] = (
    ("the yaw acceleration is given as … + L/I_z", "N/I_z: the moment about the yaw axis"),
    ("second rate row of the LPV matrix: ρ7/2 p + ρ7/2 r", "ρ7/2 p + ρ5/2 r, the correct form of p r"),
    ("ρ4 = cos θ in [0, 1]", "the model divides by it: |θ| stays below 90 deg, and 0 itself is outside"),
    ("rates bounded by 1.5 rad/s (Table II) and by 1.5π (text)", "both are judged; `rho_in_bounds` is Table II"),
    ("‖z‖₂ = ‖T‖∞, to be minimised", "‖z‖₂ ≤ ‖T‖∞ for ‖w‖₂ ≤ 1: a bound, not an equality"),
    ("D_u(ρ) without u in the measurement equation", "0: torque does not reach the gyro directly"),
    ("W_φ, W_θ, W_ψ shape the noise of rate gyros", "one weight W_n on the noise of p, q, r"),
    (
        "the nine controller states are three disturbance, three noise and three effort channels",
        "channels have no states: nine is the order of the plant (3 angles, 3 rates, 3 actuator lags)",
    ),
    (
        "`hinfsyn` handles the uncertain (`ureal`) plant",
        "it designs for the nominal plant alone; neither the paper nor this design proves the level over ρ",
    ),
    (
        "stability augmentation 'with negligible effect'",
        "gyros cannot observe attitude. The augmentation (a leak) makes the design solvable and bounds it: "
        "γ ≥ W_e W_n / leak. The design model has it; the vehicle that flies has none",
    ),
)


def list_choices(vehicle: Vehicle, scenario: Scenario) -> tuple[OpenQuestion, ...]:
    """Return the paper's gaps with the values chosen in `vehicle` and `scenario`."""
    gyro, lag = vehicle.gyro, vehicle.actuator_lag
    limits = " / ".join(f"{limit:g}" for limit in vehicle.torque_limit)
    damping, derived = (
        " / ".join(f"{value:.2g}" for value in each.rate_damping_B)
        for each in (vehicle, replace(vehicle, rate_damping=None))
    )
    return (
        ("weights behind γ = 0.25", "design D1 (`gustproof design hinfsyn D1`); the law file names its weights"),
        ("which controller at γ", "the central controller, discretised for the sample rate"),
        ("actuators, 'first order'", f"time constant {lag:g} s, limits {limits} N m"),
        ("damping of the vehicle, 'minimal'", f"rate damping {damping} 1/s; the rotors' drag gives {derived} 1/s"),
        (
            "sample rate and delay",
            f"{scenario.control_rate_hz} Hz, {scenario.delay_samples} sample(s) of delay; physics at "
            f"{scenario.physics_rate_hz} Hz",
        ),
        (
            "gyro SNR of 35 dB, relative to what",
            f"{gyro.snr_db:g} dB under {gyro.reference_rate:g} rad/s rms: "
            f"{gyro.noise_ratio * gyro.reference_rate:.2g} rad/s rms a sample, {gyro.noise_model.value}",
        ),
        ("gyro bias", "none here; the scenario `bias` has .002 rad/s"),
        *(_describe_wind(item, scenario) for item in scenario.wind),
        (
            "from gust to moment, no map",
            f"L = k v_g, M = -k u_g, N = {vehicle.gust_yaw_ratio:g} k w_g with k = {vehicle.gust_gain:g} N m/(m/s); "
            "for the paper's vehicle, k sets the 60 s peak of roll and pitch in 15 m/s turbulence to .65 N m (median "
            "of 1,000 seeds)",
        ),
        ("duration", f"{scenario.duration_s:g} s"),
        ("number of runs", "the median over the seeds"),
        (
            "PID gains and the autotuner's targets",
            "0.8 rad/s and 60 deg (the tool's own defaults: 1 rad/s, 60 deg); the law file holds the gains",
        ),
        ("peak and RMSE of three angles as one number", "the largest, and the rms over all three at once"),
        ("'actuator exertion', no measure", "rms slew of the commanded torque; its rms hardly differs"),
        ("translation", f"held at {scenario.altitude_m:g} m: only attitude is flown, as in the model"),
    )


def _describe_wind(item: Wind, scenario: Scenario) -> OpenQuestion:
    if isinstance(item, Dryden):
        speed = item.wind_speed_20ft
        airspeed = "the mean wind" if item.airspeed_mps is None else f"{item.airspeed_mps:g} m/s"
        return (
            "Dryden model: version, intensity, airspeed at hover; 'gust velocities up to 15 m/s'",
            f"{item.specification}, low altitude, {scenario.altitude_m:g} m; mean wind {speed:g} m/s at 20 ft "
            f"(itself without moment); airspeed: {airspeed}",
        )
    if isinstance(item, Constant):
        velocity = ", ".join(f"{component:g}" for component in item.velocity_N)
        return ("mean wind", f"({velocity}) m/s north, east, down; on the test stand it gives no moment")
    if isinstance(item, GustCosine):
        amplitude = ", ".join(f"{component:g}" for component in item.vector)
        return (
            "'wind gust and turbulence', no gust shape",
            f"1-cosine of ({amplitude}) m/s in {'north, east, down' if item.is_earth_frame else 'body axes'}, "
            f"{item.length_s:g} s long, at {item.start_s:g} s",
        )
    return ("'wind gust and turbulence', no gust shape", f"a '{item.kind}' of the scenario file")
