"""The vehicle's side of the UDP socket: airframe, air, sensors, autopilot, MAVLink.

    vehicle -> rigid_body, gusts, sensors -> plant --+
                  stabilizer, autopilot -------------+-> loop -> endpoint -> udp ==> datagrams

This package never imports `gustproof`: what is simulated does not know who controls it.
"""
