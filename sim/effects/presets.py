"""Names of sensors in, what they are as bad as out.

Sources, by the letters beside the values:

A  G. Gallego et al., Event-based Vision: A Survey, TPAMI 2022, table 1 (of makers and papers).
B  C. Brandli et al., A 240 x 180 130 dB 3 us Latency Global Shutter Spatiotemporal Vision Sensor,
   JSSC 2014: the DAVIS of the same pixel.
E  ESIM (Rebecq et al., CoRL 2018), esim_ros: example.conf, and the defaults of esim_node.cpp.
G  R. Graca, T. Delbruck, Unraveling the Paradox of Intensity-Dependent DVS Pixel Noise, IISW 2021.
L  P. Lichtsteiner, C. Posch, T. Delbruck, A 128 x 128 120 dB 15 us Latency Asynchronous Temporal
   Contrast Vision Sensor, JSSC 2008.
N  Y. Nozaki, T. Delbruck, Temperature and Parasitic Photocurrent Effects in Dynamic Vision
   Sensors, IEEE Trans. Electron Devices 2017.
V  v2e (Hu et al., CVPRW 2021), v2ecore/emulator.py, set_dvs_params("noisy").
R  Rates, latencies and gaps of real recordings as docs/physical.md lists them.
*  Chosen by us within what is known; docs/physical.md says why.
"""

from dataclasses import dataclass, replace

from sim.effects.config import SensorEffects
from sim.errors import SimError
from sim.sensor.events import SensorConfig


@dataclass(frozen=True)
class SensorPreset:
    """A sensor: its pixels, and how bad they and what is around them are."""

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
"""Sensors by name. The old presets of noise alone are `sim.sensor.events.PRESETS`."""


def sensor_preset(name: str) -> SensorPreset:
    """Look a sensor up.

    Raises
    ------
    SimError
        When there is none of that name.
    """
    if name not in SENSOR_PRESETS:
        raise SimError(f"sensor: expected one of {', '.join(SENSOR_PRESETS)}, got {name!r}")
    return SENSOR_PRESETS[name]
