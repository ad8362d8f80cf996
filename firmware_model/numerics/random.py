"""Streams of random numbers, one for each purpose: a new sensor leaves every gust unchanged."""

GUST_STREAM = 1
"""Turbulence: its stationary start and its noise at each sample."""
GYRO_STREAM = 2
"""Gyro noise."""
LINK_STREAM = 3
"""Link faults. `sample` is the number of the datagram in its direction, `block` the number of the fault table."""
ACCELEROMETER_STREAM = 4
"""Accelerometer noise."""
NAVIGATION_STREAM = 5
"""Noise of the navigation sensors: magnetometer and barometer in block 0, GPS in blocks 1 and 2."""
