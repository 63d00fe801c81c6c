"""The imperfections of a real sensor: their config, and presets of sensors by name."""

from dataclasses import dataclass, field, replace

from sim.errors import SimError, check_numbers
from sim.sensor.events import SensorConfig

DIM_LUX = 0.1  # light at which the dim-light shot noise is stated, and below which it is constant
LATER = {"later": True}
"""Metadata of a field that some results predate: provenance leaves it out at its default."""

_POSITIVE = ("illuminance_lux", "camera2_light", "flicker_hz", "cutoff_min_hz", "cutoff_max_hz")


@dataclass(frozen=True)
class SensorEffects:
    """Imperfections beside those of `sim.sensor.events.SensorConfig`, the same in both cameras.

    What depends on the light depends on E = illuminance_lux * (I + log_eps) [lux] of each pixel,
    with I the luminance, 0 to 1. Sources are in docs/sensor.md.
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
    dim_noise_exponent: float = 0.75  # the noise falls as E to the power of minus this
    noise_spread_decades: float = 0.0  # deviation of log10 of the pixels' leak and noise rates
    leak_jitter: float = 0.0  # deviation of the time between leak events, as a share of it
    hot_clusters: int = 0  # of 3 x 3 hot pixels each, in each camera
    hot_cluster_hz: float = 200.0  # median rate of their pixels' ON events
    latency_s: float = 0.0  # from a crossing to its stamp, in any light
    latency_lux_s: float = 0.0  # [s lux], divided by E: added to the latency
    jitter_s: float = 0.0  # standard deviation of a stamp, in any light
    jitter_lux_s: float = 0.0  # [s lux], divided by E: added to this deviation
    readout_hz: float = 0.0  # events read out per second; 0: any number at once
    readout_queue: int = 1_000_000  # most events that wait for the readout; more are lost
    scan_s: float = field(default=0.0, metadata=LATER)  # between scans of all pixels; 0: none
    frame_gap_s: float = 0.0  # events are lost after each exposure, while the frame is read out
    frame_phase_spread: float = 0.0  # share of the period from which a camera's phase is drawn
    frame_read_noise: float = 0.0  # standard deviation in a frame, as a share of full scale
    frame_full_well_e: float = 0.0  # electrons at full scale, for frames' shot noise; 0: none

    def __post_init__(self) -> None:
        check_numbers(self, "effects: ", or_zero=vars(self))
        check_numbers(self, "effects: ", _POSITIVE)
        low_hz, high_hz, queue = self.cutoff_min_hz, self.cutoff_max_hz, self.readout_queue
        for is_right, said in (
            (self.frame_phase_spread <= 1.0,
             f"frame_phase_spread is a share, 0 to 1, got {self.frame_phase_spread}"),
            (self.flicker_depth < 1.0,
             f"flicker_depth must be less than 1, got {self.flicker_depth}: there is no negative "
             "light"),
            (low_hz <= high_hz,
             f"cutoff_min_hz must be at most cutoff_max_hz, got {low_hz} and {high_hz}"),
            (queue >= 1,
             f"readout_queue must be 1 or more, got {queue}: leave out readout_hz for a readout "
             "without a queue"),
        ):  # fmt: skip
            if not is_right:
                raise SimError(f"effects: {said}")

    @property
    def is_none(self) -> bool:
        """Whether there are no effects at all."""
        return self == SensorEffects()

    def of_camera(self, index: int) -> "SensorEffects":
        """Return the effects of one camera; index 1 has its light scaled by `camera2_light`."""
        if index != 1:
            return self
        lux = self.illuminance_lux * self.camera2_light
        return replace(self, illuminance_lux=lux, camera2_light=1.0)


@dataclass(frozen=True)
class SensorPreset:
    """A sensor: the model of its pixels, and the effects in and around them."""

    sensor: SensorConfig
    effects: SensorEffects


_DAVIS346_PIXELS = SensorConfig(
    threshold_on=0.25,  # A: contrasts of 14.3 to 22.5 % at the least; * in use
    threshold_off=0.25,
    threshold_mismatch=0.009,  # B: 3.5 % of the threshold
    refractory_s=0.0005,  # *
    leak_hz=0.2,  # R, N: 0.08 to 0.25 in bright light, all ON
    hot_pixel_share=2.5e-3,  # R: pixels above 5 Hz
    hot_pixel_hz=10.0,  # *
)
_DAVIS346 = SensorEffects(
    illuminance_lux=500.0,  # *: a lit room's
    blur_px=0.5,  # *: a focused lens
    cutoff_hz_per_lux=30.0,  # R, L: in proportion to the light, 30 Hz to kHz
    cutoff_max_hz=3000.0,  # L, R
    dim_noise_on_hz=5.0,  # R, G: at 0.1 lux
    dim_noise_off_hz=3.7,  # R, G
    dim_noise_exponent=0.75,  # *: then less than 0.05 Hz at 161 lux, where R has ON alone
    noise_spread_decades=0.25,  # R: 95th percentiles of 11 and 9 Hz
    leak_jitter=0.1,  # V
    hot_clusters=2,  # *
    latency_s=100e-6,  # R: in good light
    latency_lux_s=1e-3,  # R: 1 ms and more in dim light
    jitter_s=10e-6,  # R
    jitter_lux_s=1e-4,  # *: as large a share of the latency as in good light
    readout_hz=12e6,  # A
    readout_queue=4096,  # *: buffers of the USB bridge
    frame_gap_s=0.010,  # R: 5 to 25 ms
    frame_phase_spread=1.0,  # cameras that nothing synchronises
    frame_read_noise=0.003,  # B: 51 dB of range in a frame
    frame_full_well_e=10_000.0,  # *
)

SENSOR_PRESETS = {
    "davis346": SensorPreset(_DAVIS346_PIXELS, _DAVIS346),
    "davis346-dim": SensorPreset(
        _DAVIS346_PIXELS,
        replace(
            _DAVIS346,
            illuminance_lux=5.0,  # *: a room in the evening
            flicker_depth=0.05,  # *: of lamps at the mains
            frame_gap_s=0.015,  # R
        ),
    ),
    "evk4": SensorPreset(
        SensorConfig(
            threshold_on=0.22,  # *: the maker's default of 25 % contrast
            threshold_off=0.22,
            threshold_mismatch=0.007,  # *: 3 %, as B
            refractory_s=0.0002,  # *
            leak_hz=0.1,  # R
            hot_pixel_share=1e-4,  # *
            hot_pixel_hz=50.0,  # *
        ),
        SensorEffects(
            illuminance_lux=500.0,  # *
            blur_px=0.7,  # *: pixels of 4.86 um are small for a lens
            cutoff_hz_per_lux=30.0,  # R, L
            cutoff_max_hz=2000.0,  # *
            dim_noise_on_hz=5.0,  # R, G
            dim_noise_off_hz=3.7,  # R, G
            noise_spread_decades=0.25,  # R
            leak_jitter=0.1,  # V
            latency_s=150e-6,  # A: 20 to 150 us
            latency_lux_s=1e-3,  # R
            jitter_s=15e-6,  # *: as large a share of the latency as of a DAVIS
            jitter_lux_s=1e-4,  # *
            readout_hz=1.066e9,  # A
            readout_queue=100_000,  # *
        ),
    ),
    "esim": SensorPreset(
        SensorConfig(
            threshold_on=0.5,  # E: example.conf
            threshold_off=0.5,  # E
            threshold_mismatch=0.021,  # E: contrast_threshold_sigma_pos and _neg
            refractory_s=100e-6,  # E: refractory_period_ns
        ),
        SensorEffects(),
    ),
    "v2e-noisy": SensorPreset(
        SensorConfig(
            threshold_on=0.2,  # V: pos_thres
            threshold_off=0.2,  # V: neg_thres
            threshold_mismatch=0.05,  # V: sigma_thres
            refractory_s=0.01,  # V: refractory_period_s
            leak_hz=0.1,  # V: leak_rate_hz
            shot_noise_hz=5.0,  # V: shot_noise_rate_hz, a quarter of it in full light
        ),
        SensorEffects(
            illuminance_lux=1.0,  # only the product with the next counts
            cutoff_hz_per_lux=30.0,  # V: cutoff_hz at white
            cutoff_min_hz=2.2,  # V: 20 / 275 of it at black
            leak_jitter=0.1,  # V: leak_jitter_fraction
            noise_spread_decades=0.1,  # V: noise_rate_cov_decades
        ),
    ),
}
"""Sensors by name. Presets of pixel noise alone are `sim.sensor.events.PRESETS`."""
