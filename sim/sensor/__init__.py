"""Luminance over time in, events and intensity frames out."""

from sim.sensor.buffer import EVENT_DTYPE
from sim.sensor.events import Sensor, SensorConfig, events_from_frames
from sim.sensor.frames import FrameConfig, FrameExposer

__all__ = [
    "EVENT_DTYPE",
    "FrameConfig",
    "FrameExposer",
    "Sensor",
    "SensorConfig",
    "events_from_frames",
]
