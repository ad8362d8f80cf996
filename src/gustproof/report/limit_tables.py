"""Tables of the performance limits in turbulence."""

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from gustproof.analysis.placement import ErrorLimits

_NOTE = (
    "Limits are small-angle averages over many flights; few flights scatter. Gyro noise alone makes the attitude "
    "drift, whatever the law; only the part above 'any slew' can be tuned away. The second table holds linear laws "
    "that were found, so it lies above the limit: by 1 % at Ms 1.15, .2 % from 1.36 on. In the first table and in the "
    "column 'any', no law is better, linear or not."
)


def render_limits(limits: ErrorLimits) -> RenderableType:
    """Return the limits by the information of a law, and the trade-off with the sensitivity peak."""
    known = Table("known to the law", title=f"Least possible RMSE in '{limits.scenario}' [deg]")
    known.add_column(f"slew {limits.slew:g} N m/s", justify="right")
    known.add_column("any slew", justify="right")
    known.add_row("gyros, the true spectra", f"{limits.gyro_deg:.4f}", f"{limits.gyro_any_slew_deg:.4f}")
    known.add_row("state and air, exactly", f"{limits.clairvoyant_deg:.2g}", f"{limits.clairvoyant_any_slew_deg:.2g}")
    traded = Table("slew [N m/s]", title="Least RMSE [deg] of linear gyro-only laws by sensitivity peak Ms")
    rows = {
        curve.slew: {
            **{f"{peak:.2f}": rmse for peak, rmse in zip(curve.Ms, curve.rmse_deg, strict=True)},
            "any": curve.any_Ms_deg,
        }
        for curve in limits.curves
    }
    peaks = sorted({peak for row in rows.values() for peak in row})
    for peak in peaks:
        traded.add_column(peak, justify="right")
    for slew, row in rows.items():
        traded.add_row(f"{slew:g}", *(f"{row[peak]:.4f}" if peak in row else "-" for peak in peaks))
    return Group(known, traded, Text(_NOTE, style="dim"))
