"""Luminance over time in, events and intensity frames out."""

from sim.sensor.events import EVENT_DTYPE, Sensor, SensorConfig, events_from_frames
from sim.sensor.frames import FrameConfig, FrameExposer

__all__ = [
    "EVENT_DTYPE",
    "FrameConfig",
    "FrameExposer",
    "Sensor",
    "SensorConfig",
    "events_from_frames",
]
