"""Options that hold three numbers."""

import math

from firmware_model.errors import ConfigError


def parse_positive_vector(option: str, text: str) -> tuple[float, float, float]:
    """Return the three numbers of `text`, written "x,y,z".

    Raises
    ------
    ConfigError
        If they are not three positive, finite numbers.
    """
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"{option}: is '{text}', must be three numbers, such as 0.65,0.65,0.3") from None
    if not all(math.isfinite(value) and value > 0.0 for value in (x, y, z)):
        raise ConfigError(f"{option}: is '{text}', every number must be positive and finite")
    return x, y, z
