"""A profile sensor that is read through its Modbus registers."""

from sim.register_profiler.sensor import Measuring, RegisterSensor, RegisterSettings

__all__ = ["Measuring", "RegisterSensor", "RegisterSettings"]
