"""Streams of random numbers: one for each purpose, so that a new sensor leaves every gust as it was."""

GUST_STREAM = 1
"""Turbulence: its stationary start and its noise at each sample."""
GYRO_STREAM = 2
"""Gyro noise."""
LINK_STREAM = 3
"""Link faults; the sample is the number of the datagram in its direction, the block that of the table."""
ACCELEROMETER_STREAM = 4
"""Accelerometer noise."""
