"""What two cameras recorded in; it checked, denoised and summed up for all methods out.

Malformed input raises SsacError.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ssac.camera import Camera, Rig, same_camera
from ssac.config import N_MIN, Config, checked
from ssac.errors import SsacError
from ssac.events import EVENT_DTYPE, US_PER_S, check_events, copied
from ssac.points import PointTrack, check_track
from ssac.track.denoise import Clutter, without_noise
from ssac.track.motion import Motion, ObjectMotion, no_gaps, object_motion
from ssac.track.point_motion import point_motion
from ssac.track.thin_line import events_on_line

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prepared:
    """What `prepare` found in one camera's events, and what from, so that it is not done again."""

    events: NDArray[np.void]  # (n,) the very array of the Observation, checked against the camera
    camera: Camera
    border_px: int  # as in Config
    motion: ObjectMotion  # of the events


@dataclass(frozen=True)
class Observation:
    """What one camera recorded, in its own clock."""

    events: NDArray[np.void]  # (n,) of EVENT_DTYPE, sorted by time
    frames: NDArray[np.generic] | None = None  # (m, height, width) intensities, for ZNCC_F
    frame_times_s: Array | None = None  # (m,) [s], ascending
    denoised: bool = False  # the noise has left the events already: no method removes it again
    prepared: Prepared | None = None  # by `prepare`; None: each method starts from the events
    track: PointTrack | None = None  # in place of events, of which there are then none
    clutter: Clutter | None = None  # what denoising did here; None: nothing yet, or elsewhere
    gaps_us: NDArray[np.int64] = field(default_factory=no_gaps)
    """Times (g, 2) [us], ascending, from and up to which events of the object were taken out with
    others: windows that reach into them hold a part of what was seen."""
    on_line: NDArray[np.bool_] | None = None
    """Which events (n,) lie where a thin line holds the object; None: there is none, as far as
    denoising saw."""

    def __post_init__(self) -> None:
        if self.prepared is not None and self.prepared.events is not self.events:
            raise SsacError(
                "a prepared Observation must keep its events, but other events were put in their"
                " place: make a new Observation of these, and prepare it"
            )

    def delayed(self, t_d_s: float) -> "Observation":
        """As if the camera's clock had shown `t_d_s` [s] more; what is prepared stays so.

        Events count whole microseconds, so the delay is rounded to these, for frames as well.
        """
        shift_us = round(t_d_s * US_PER_S)
        events = copied(self.events)
        events["t"] += shift_us
        times_s, prepared = self.frame_times_s, self.prepared
        if times_s is not None:
            times_s = times_s + shift_us / US_PER_S
        if prepared is not None:
            prepared = replace(prepared, events=events, motion=prepared.motion.delayed(shift_us))
        track = self.track
        if track is not None:
            track = replace(track, times_s=track.times_s + shift_us / US_PER_S)
        gaps_us = self.gaps_us + shift_us
        found = prepared, track, self.clutter, gaps_us, self.on_line
        return Observation(events, self.frames, times_s, self.denoised, *found)

    def n_min(self, config: Config) -> int:
        """Events that a window holds at least: the config's, or as denoising found."""
        if config.n_min is not None:
            return config.n_min
        return N_MIN if self.clutter is None else self.clutter.n_min

    @property
    def span_s(self) -> tuple[float, float]:
        """Times [s] of the first and the last event or point; (inf, -inf) of none."""
        if self.track is not None:
            times_s = self.track.times_s
            return (float(times_s[0]), float(times_s[-1])) if len(times_s) else (np.inf, -np.inf)
        if len(self.events) == 0:
            return np.inf, -np.inf
        start_us, end_us = self.events["t"][[0, -1]]
        return float(start_us) / US_PER_S, float(end_us) / US_PER_S


def tracked(track: PointTrack) -> Observation:
    """Observe with a camera of any kind, which gave a track in place of events."""
    return Observation(np.empty(0, EVENT_DTYPE), denoised=True, track=track)


def prepare(
    cam1: Observation, cam2: Observation, rig: Rig, config: Config | None = None
) -> tuple[Observation, Observation]:
    """Check, denoise and sum up the events once, for many methods and offsets.

    Every method gives the same estimate for the result as for what the cameras recorded, as long
    as the cameras, `border_px`, `denoise` and `n_neighbours` stay as they are here; all else of the
    config may change at no cost. What another camera or border needs is done again from the events
    left, and denoising that was skipped is made up for, but noise once removed does not come back.

    Parameters
    ----------
    cam1, cam2
        What the two cameras recorded.
    rig
        Intrinsics; the extrinsics are not used.
    config
        Parameters; the defaults when None.

    Returns
    -------
    tuple of Observation
        Of camera 1 and camera 2, with `prepared`, and with the usable events as their events.

    Raises
    ------
    SsacError
        As `usable_events`, or if a parameter makes no sense.
    """
    config = checked(config)
    cam1, cam2 = denoised(cam1, cam2, rig, config)
    return _with_motion(cam1, rig.cam1, config), _with_motion(cam2, rig.cam2, config)


def denoised(
    cam1: Observation, cam2: Observation, rig: Rig, config: Config
) -> tuple[Observation, Observation]:
    """Both cameras with `usable_events`, which say of themselves what was done to them.

    Raises as `usable_events` does.
    """
    _check(cam1, cam2, rig)
    return _denoised(cam1, rig.cam1, config), _denoised(cam2, rig.cam2, config)


def usable_events(
    cam1: Observation, cam2: Observation, rig: Rig, config: Config
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Both cameras' events, checked, and denoised (Sec. IV-A) if the config asks for it.

    Raises
    ------
    SsacError
        If the events of a camera are empty, unsorted or outside its sensor.
    """
    first, second = denoised(cam1, cam2, rig, config)
    return first.events, second.events


def object_motions(
    cam1: Observation, cam2: Observation, rig: Rig, config: Config
) -> tuple[Motion, Motion]:
    """Prepare the object's motion in both views: the paper's Sec. IV-A.

    Raises as `usable_events` does. One camera's denoised events are gone before the other's come.
    """
    _check(cam1, cam2, rig)
    return _motion(cam1, rig.cam1, config), _motion(cam2, rig.cam2, config)


def denoised_alone(observation: Observation, camera: Camera, config: Config) -> Observation:
    """One camera as `denoised` gives it."""
    _check_one(observation, camera, "camera")
    return _denoised(observation, camera, config)


def motion_alone(observation: Observation, camera: Camera, config: Config) -> Motion:
    """One camera's motion as `object_motions` gives it."""
    _check_one(observation, camera, "camera")
    return _motion(observation, camera, config)


def _check(cam1: Observation, cam2: Observation, rig: Rig) -> None:
    _check_one(cam1, rig.cam1, "camera 1")
    _check_one(cam2, rig.cam2, "camera 2")


def _check_one(observation: Observation, camera: Camera, name: str) -> None:
    """Refuse events that cannot be used."""
    if observation.track is not None:
        check_track(observation.track, camera.width, camera.height, name)
    elif observation.prepared is None or not same_camera(observation.prepared.camera, camera):
        check_events(observation.events, camera.width, camera.height, name)


def _denoised(observation: Observation, camera: Camera, config: Config) -> Observation:
    """One camera without noise if the config asks for it, else the very same observation."""
    if observation.denoised or not config.denoise:
        return observation
    events, clutter = without_noise(
        observation.events, camera.width, camera.height, config.n_neighbours
    )
    return Observation(
        events,
        observation.frames,
        observation.frame_times_s,
        denoised=True,
        clutter=clutter,
        gaps_us=observation.gaps_us,
        on_line=events_on_line(observation.events, events, camera.width, camera.height),
    )


def _motion(observation: Observation, camera: Camera, config: Config) -> Motion:
    if observation.track is not None:
        return point_motion(observation.track, camera, config.half_window_s)
    return _motion_of_events(observation, camera, config)


def _motion_of_events(observation: Observation, camera: Camera, config: Config) -> ObjectMotion:
    """Motion of the usable events: the prepared one, where it is of these events and this camera.

    What it sums up does not depend on the parameters of its windows.
    """
    observation = _denoised(observation, camera, config)
    known, n_min = observation.prepared, observation.n_min(config)
    if (
        known is not None
        and known.border_px == config.border_px
        and same_camera(known.camera, camera)
    ):
        return known.motion.sampled_by(config.half_window_s, n_min, config.max_border_fraction)
    motion = _summed_up(observation, observation.events, camera, config)
    if observation.on_line is None:
        return motion
    bare = observation.events[~observation.on_line]
    return replace(motion, bare=_summed_up(observation, bare, camera, config))


def _summed_up(
    observation: Observation, events: NDArray[np.void], camera: Camera, config: Config
) -> ObjectMotion:
    """Motion of some of the usable events."""
    motion = object_motion(
        events,
        camera,
        half_window_s=config.half_window_s,
        n_min=observation.n_min(config),
        border_px=config.border_px,
        max_border_fraction=config.max_border_fraction,
    )
    return replace(motion, gaps_us=observation.gaps_us)


def _with_motion(observation: Observation, camera: Camera, config: Config) -> Observation:
    if observation.track is not None:
        return observation
    motion = _motion_of_events(observation, camera, config)
    prepared = Prepared(observation.events, camera, config.border_px, motion)
    return replace(observation, prepared=prepared)
