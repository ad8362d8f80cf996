"""An autopilot's own rate loop as second-order models, axis by axis: its file, and the fit to a flight."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy

from firmware_model.config.fields import NonNegative, Positive, strict_dataclass
from firmware_model.config.files import Name, read_document, validate
from gustproof.design.cascades.autotune import ComplexVector
from gustproof.errors import DesignError
from gustproof.robust.lti.state_space import ComplexMatrix, Matrix

_SAMPLES_LATE = 1.5  # half a sample of hold and one of delay: every sampled loop has these in its margins
_WORST_MISFIT = 0.5  # [-]; a response that far from the model is none of a rate loop
RESONANCE = 3.0
"""[-] A loop with such a peak is about to oscillate: a law over it has to be slow."""
_AT_RESONANCE = 0.25  # [-] open loop there, so that a law adds at most a third to the resonance, whatever the phase


@strict_dataclass
class InnerLoop:
    """Rate command to rate of one axis: `omega^2 exp(-delay s) / (s^2 + 2 damping omega s + omega^2)`."""

    omega: Positive
    """[rad/s] natural frequency."""
    damping: Positive
    """[-] of critical damping."""
    delay: NonNegative = 0.0
    """[s] of link and autopilot, beyond the hold and the one sample that a sampled law has anyway."""
    misfit: NonNegative = 0.0
    """[-] largest distance between measured and modelled response, for a command of 1."""

    @property
    def peak(self) -> float:
        """[-] Largest gain from command to rate; 1 if it does not resonate."""
        damping = min(self.damping, math.sqrt(0.5))
        return 0.5 / (damping * math.sqrt(1.0 - damping**2))

    def without_delay(self) -> tuple[float, float]:
        """Return natural frequency [rad/s] and damping [-] of the loop whose series in s agrees to second order."""
        a = 2.0 * self.damping / self.omega
        slope, curvature = a + self.delay, self.omega**-2 + a * self.delay + 0.5 * self.delay**2
        omega = curvature**-0.5
        return omega, 0.5 * slope * omega


@strict_dataclass
class InnerLoops:
    """Rate loops of an autopilot with its gains on its vehicle."""

    name: Name
    """Short name; defaults to the file's."""
    roll: InnerLoop
    """About x."""
    pitch: InnerLoop
    """About y."""
    yaw: InnerLoop
    """About z."""
    description: str = ""
    """Description in one line."""

    def fastest(self) -> Matrix:
        """Return the frequencies (3,) [rad/s] up to which the loops follow: natural, or of half power if less.

        Where a loop resonates: those at which an open loop that falls as 1/s crosses 1 to be `_AT_RESONANCE` there.
        """
        omega, damping = self.without_delay()
        a = 1.0 - 2.0 * damping**2
        fastest: Matrix = omega * np.minimum(np.sqrt(a + np.sqrt(a**2 + 1.0)), 1.0)
        for axis, loop in enumerate((self.roll, self.pitch, self.yaw)):
            if loop.peak >= RESONANCE:
                fastest[axis] = _AT_RESONANCE * loop.omega / loop.peak
        return fastest

    def without_delay(self) -> tuple[Matrix, Matrix]:
        """Return natural frequencies (3,) [rad/s] and dampings (3,) [-], with the delays in them."""
        omega, damping = np.transpose([axis.without_delay() for axis in (self.roll, self.pitch, self.yaw)])
        return omega, damping


def load_inner_loops(path: str | Path) -> InnerLoops:
    """Read the file of an autopilot's rate loops.

    Raises
    ------
    ConfigError
        If there is no such file, or a key or value is not allowed.
    """
    path = Path(path)
    return validate(InnerLoops, {"name": path.stem, **read_document(path)}, str(path))


def fit_inner_loop(omega: Matrix, response: ComplexVector, dt: float, axis: str) -> InnerLoop:
    """Return the loop nearest to the response (n,) at `omega` (n,) [rad/s] from commands sampled every `dt` [s].

    The gain at rest is 1: an autopilot's rate loop has an integrator. `axis` names it for users.

    Raises
    ------
    DesignError
        If no such loop is near.
    """

    def misfit(x: Matrix) -> Matrix:
        difference = _response(omega, math.exp(x[0]), math.exp(x[1]), x[2]) - response
        return np.concatenate([difference.real, difference.imag])

    bounds = ([math.log(0.5), math.log(0.02), 0.0], [math.log(200.0), math.log(20.0), 0.3])
    starts: Sequence[float] = (3.0, 10.0, 30.0)
    fits = [scipy.optimize.least_squares(misfit, [math.log(start), 0.0, 0.02], bounds=bounds) for start in starts]
    x = min(fits, key=lambda fit: float(fit.cost)).x
    distance = float(np.max(np.abs(_response(omega, math.exp(x[0]), math.exp(x[1]), x[2]) - response)))
    if not distance < _WORST_MISFIT:
        highest = int(np.argmax(np.abs(response)))
        if (peak := float(np.abs(response[highest]))) > RESONANCE:
            near = f"answers {peak:.1f} times its command at {omega[highest]:.1f} rad/s"
            raise DesignError(f"{axis} {near}: the autopilot is about to oscillate there, change its gains first")
        raise DesignError(
            f"the response in {axis} is not that of a rate loop: {distance:.2f} from the nearest, for a command of 1"
        )
    delay = max(float(x[2]) - _SAMPLES_LATE * dt, 0.0)
    return InnerLoop(omega=math.exp(x[0]), damping=math.exp(x[1]), delay=delay, misfit=distance)


def _response(omega: Matrix, natural: float, damping: float, delay: float) -> ComplexMatrix:
    s = 1j * omega
    result: ComplexMatrix = natural**2 * np.exp(-delay * s) / (s**2 + 2.0 * damping * natural * s + natural**2)
    return result
