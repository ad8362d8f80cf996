"""Own the sockets, the clock and the process: UDP loop, access, real-time hints, logs."""
