"""Design, prove and fly multirotor attitude control in gusts, over real MAVLink."""

__version__ = "0.1.0"
