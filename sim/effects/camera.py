"""One camera's effects, drawn from the recording's seed: lens, pixels, readout and frames."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.effects.config import SensorEffects
from sim.effects.frames import NoisyImages
from sim.effects.lens import blurred_crops, blurred_image
from sim.effects.pixels import EffectsSensor
from sim.effects.readout import queued, without_gaps
from sim.errors import SimError
from sim.render.renderer import Crops
from sim.seeds import generator
from sim.sensor.events import Sensor, SensorConfig
from sim.sensor.frames import FrameConfig, Images

# Branches of the seed, beside those of `sim.recording` and `sim.disturb`: of all cameras, and of
# each its pixels and its frames.
_STREAM = 3
_LAMPS, _PIXELS, _PHASE, _FRAMES = range(4)


class CameraEffects:
    """What stands between one camera's light and what it records; nothing by default.

    Parameters
    ----------
    effects, sensor, frames
        Of the recording.
    background
        Luminance (height, width) of the empty scene.
    seed
        Of the recording.
    index
        Of the camera, 0 or 1.

    Raises
    ------
    SimError
        When a frame's readout would end after the next frame's exposure.
    """

    def __init__(
        self,
        effects: SensorEffects,
        sensor: SensorConfig,
        frames: FrameConfig,
        background: NDArray[np.float32],
        seed: int,
        index: int,
    ) -> None:
        check_gap(effects, frames)
        self.effects = effects.of_camera(index)
        self._sensor, self._frames = sensor, frames
        self._seed, self._index = seed, index
        self._sharp = background
        self.background = background
        """Luminance (height, width) of the empty scene behind the lens."""
        if effects.blur_px:
            self.background = blurred_image(background, effects.blur_px)
        self.flicker_rad = self._rng(_LAMPS, 0).uniform(0.0, 2.0 * np.pi)  # common to the cameras
        self.frame_start_s = 0.0
        """When the first frame's exposure begins [s]."""
        if effects.frame_phase_spread and frames.rate_hz:
            share = effects.frame_phase_spread * self._rng(_PHASE, index).random()
            self.frame_start_s = share / frames.rate_hz

    def through_lens(self, crops: Crops) -> Crops:
        """Blur crops of the sharp image."""
        if not self.effects.blur_px:
            return crops
        return blurred_crops(crops, self.effects.blur_px, self._sharp, self.background)

    def start_sensor(
        self,
        image: NDArray[np.float32],
        time_s: float,
        rng: np.random.Generator,
        background: NDArray[np.float32] | None = None,
    ) -> Sensor:
        """Start the pixels, of light behind the lens, as `Sensor` starts."""
        if self.effects.is_none:
            return Sensor(self._sensor, image, time_s, rng, background)
        effects_rng = self._rng(_PIXELS, self._index)
        about = (self._sensor, self.effects, image, time_s, rng, background)
        return EffectsSensor(*about, effects_rng, self.flicker_rad)

    def read_out(self, events: NDArray[Any], end_s: float) -> NDArray[Any]:
        """Deliver all events of a recording that ends at a time, as the readout does.

        Parameters
        ----------
        events
            EVENT_DTYPE, sorted by time [us of the scene].
        end_s

        Returns
        -------
        NDArray
            EVENT_DTYPE, sorted by time, none outside of the recording.
        """
        effects, frames = self.effects, self._frames
        if effects.is_none:
            return events
        if effects.frame_gap_s and frames.rate_hz:
            n_frames = int(np.ceil(end_s * frames.rate_hz)) + 1
            ends_s = self.frame_start_s + np.arange(n_frames) / frames.rate_hz + frames.exposure_s
            events = without_gaps(events, 1e6 * ends_s, 1e6 * effects.frame_gap_s)
        if effects.readout_hz:
            events = queued(events, effects.readout_hz, effects.readout_queue)
        is_within = (events["t"] >= 0) & (events["t"] <= np.rint(1e6 * end_s))
        recorded: NDArray[Any] = events[is_within]
        return recorded

    def images(self, images: Images) -> Images:
        """Give what takes frames without effects and hands them on with theirs."""
        effects = self.effects
        if not (effects.frame_read_noise or effects.frame_full_well_e or effects.flicker_depth):
            return images
        rng = self._rng(_FRAMES, self._index)
        about = (effects, self._frames, self.frame_start_s)
        return NoisyImages(images, *about, rng, self.flicker_rad)

    def _rng(self, stream: int, index: int) -> np.random.Generator:
        return generator(self._seed, _STREAM, stream, index)


def check_gap(effects: SensorEffects, frames: FrameConfig) -> None:
    """Refuse frames that are read out for longer than they are apart.

    Raises
    ------
    SimError
    """
    if effects.frame_gap_s * frames.rate_hz >= 1.0:
        raise SimError(
            f"effects: frame_gap_s must be less than 1 / rate_hz of the frames = "
            f"{1.0 / frames.rate_hz:g} s, got {effects.frame_gap_s:g}: no event would be left"
        )
