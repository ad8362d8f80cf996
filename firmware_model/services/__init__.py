"""MAVLink microservices, one file a group; each knows its own messages and no socket."""
