"""How bad a sensor is, as one frozen dataclass; by default it is ideal."""

from dataclasses import astuple, dataclass, replace

import numpy as np

from sim.errors import SimError

DIM_LUX = 0.1
"""Light at which the shot noise of `SensorEffects` is stated, and below which it stays."""

_POSITIVE = ("illuminance_lux", "camera2_light", "flicker_hz", "cutoff_min_hz", "cutoff_max_hz")
_SHARES = ("frame_phase_spread",)


@dataclass(frozen=True)
class SensorEffects:
    """Imperfections beside those of `sim.sensor.events.SensorConfig`, the same in both cameras.

    What depends on the light depends on E = illuminance_lux * (I + log_eps) [lux] of each pixel,
    with I the luminance, 0 to 1. Sources are in docs/physical.md.
    """

    illuminance_lux: float = 1000.0  # light that luminance 1 stands for
    camera2_light: float = 1.0  # share of it that reaches camera 2's pixels: aperture or filter
    blur_px: float = 0.0  # deviation of the lens's Gaussian point spread, in events and frames
    flicker_depth: float = 0.0  # all light is I (1 + depth cos(2 pi flicker_hz t + phase))
    flicker_hz: float = 100.0  # lamps at mains of 50 Hz are bright at both crests
    cutoff_hz_per_lux: float = 0.0  # of the photoreceptor's first-order low-pass; 0: none
    cutoff_min_hz: float = 3.0  # its cut-off in the dark
    cutoff_max_hz: float = 5000.0  # its cut-off in any light
    dim_noise_on_hz: float = 0.0  # shot noise of a pixel at 0.1 lux, ON
    dim_noise_off_hz: float = 0.0  # the same, OFF
    dim_noise_exponent: float = 0.75  # of the light by which that noise is divided
    noise_spread_decades: float = 0.0  # deviation of log10 of the pixels' leak and noise rates
    leak_jitter: float = 0.0  # deviation of the time between leak events, as a share of it
    hot_clusters: int = 0  # of 3 x 3 hot pixels each, in each camera
    hot_cluster_hz: float = 200.0  # median rate of their pixels' ON events
    latency_s: float = 0.0  # from a crossing to its stamp, in any light
    latency_lux_s: float = 0.0  # this divided by E more [s lux]
    jitter_s: float = 0.0  # deviation of a stamp, in any light
    jitter_lux_s: float = 0.0  # this divided by E more [s lux]
    readout_hz: float = 0.0  # events read out per second; 0: any number at once
    readout_queue: int = 1_000_000  # events that wait for it at most; more are lost
    frame_gap_s: float = 0.0  # after each exposure a frame is read out, and events are lost
    frame_phase_spread: float = 0.0  # share of the period from which a camera's phase is drawn
    frame_read_noise: float = 0.0  # deviation of a frame's pixels, of full scale
    frame_full_well_e: float = 0.0  # electrons of full scale, which have shot noise; 0: none

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise SimError(f"effects: {name} must be 0 or a positive number, got {value}")
            if name in _POSITIVE and value == 0.0:
                raise SimError(f"effects: {name} must be a positive number, got {value}")
            if name in _SHARES and value > 1.0:
                raise SimError(f"effects: {name} is a share, 0 to 1, got {value}")
        if self.flicker_depth >= 1.0:
            raise SimError(
                f"effects: flicker_depth must be less than 1, got {self.flicker_depth}: "
                "there is no negative light"
            )
        if self.cutoff_min_hz > self.cutoff_max_hz:
            raise SimError(
                f"effects: cutoff_min_hz must be at most cutoff_max_hz, got {self.cutoff_min_hz} "
                f"and {self.cutoff_max_hz}"
            )
        if self.readout_queue < 1:
            raise SimError(
                f"effects: readout_queue must be 1 or more, got {self.readout_queue}: "
                "leave out readout_hz for a readout without a queue"
            )

    @property
    def is_none(self) -> bool:
        """Whether the sensor stays as it is."""
        return astuple(self) == astuple(SensorEffects())

    def of_camera(self, index: int) -> "SensorEffects":
        """Give the effects in one camera: the second may see another light."""
        if index != 1:
            return self
        lux = self.illuminance_lux * self.camera2_light
        return replace(self, illuminance_lux=lux, camera2_light=1.0)
