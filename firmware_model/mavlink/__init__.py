"""Speak MAVLink without sockets: frames, messages, peers, signing, services."""
