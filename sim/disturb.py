"""Adds to simulated recordings what spoils real ones: clutter and wrong intrinsics.

Clutter is drawn in each camera's image independently, so it has no correspondences between views;
only a second object is seen by both cameras. Clutter and drone do not occlude each other.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.arrays import Float32Array, FloatArray
from sim.effects.pixels import CLUSTER_PX
from sim.errors import SimError, check_numbers
from sim.recorded import CameraRecording, Recording
from sim.recording import Progress, SimConfig, simulate, unseen
from sim.seeds import generator
from sim.sensor.events import HOT_SPREAD, SensorConfig, slow_events
from sim.sensor.frames import FrameConfig
from sim.sensor.kernels import EVENT_DTYPE
from sim.storage import Recorded, WriteMore, check_out_dir, save_recording


@dataclass(frozen=True)
class DisturbConfig:
    """How a recording is spoilt: alike in both cameras, but drawn for each independently."""

    lamp_px: int = 0  # side of the square of pixels that a lamp makes flicker
    hot_clusters: int = 0  # of 3 x 3 pixels each
    noise_hz: float = 0.0  # rate of noise events of each pixel
    branches: int = 0  # number of events of swaying branches, in each camera
    people: int = 0  # number of people who walk through the view
    clouds_px_s: float = 0.0  # speed at which clouds drift over the sky
    second_object: float = 0.0  # share of the events of another flight that is added
    intrinsics_error: tuple[float, float] = (0.0, 0.0)
    """Standard deviations of the rig's errors: focal lengths [%], principal point [px]."""

    def __post_init__(self) -> None:
        check_numbers(self, "disturbance: ", or_zero=_CLUTTER)
        if not 0.0 <= self.second_object <= 1.0:
            raise SimError(
                f"disturbance: second_object is a share, 0 to 1, got {self.second_object}"
            )
        percent, centre_px = self.intrinsics_error
        if not (0.0 <= percent <= MAX_FOCAL_PERCENT and 0.0 <= centre_px < np.inf):
            raise SimError(
                f"disturbance: intrinsics_error needs 0 to {MAX_FOCAL_PERCENT:g} % and 0 px or "
                f"more, got {percent} and {centre_px}"
            )


MAX_FOCAL_PERCENT = 10.0  # ten such deviations are a whole focal length
LAMP_HZ = 100.0  # mains of 50 Hz: bright at both crests
LAMP_STEPS = 2  # thresholds that its light passes on the way up, and again on the way down
LAMP_JITTER_S = 1e-4
CLUSTER_HZ = 200.0  # median rate of a hot cluster's pixels


@dataclass(frozen=True)
class View:
    """The image and the time span that clutter fills."""

    width: int  # [px]
    height: int  # [px]
    duration_s: float

    def events(
        self, times_s: FloatArray, x_px: ArrayLike, y_px: ArrayLike, brighter: ArrayLike
    ) -> NDArray[Any]:
        """Make events of times and pixels, which broadcast; drop those outside view or duration."""
        t_us, x, y, p = np.broadcast_arrays(
            np.floor(1e6 * times_s), np.rint(x_px), np.rint(y_px), brighter
        )
        inside = (t_us >= 0) & (t_us < 1e6 * self.duration_s)
        inside &= (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        events = np.empty(int(inside.sum()), EVENT_DTYPE)
        for name, values in (("t", t_us), ("x", x), ("y", y), ("p", p)):
            events[name] = values[inside]
        return events


def lamp(view: View, size_px: int, rng: np.random.Generator) -> NDArray[Any]:
    """Let a square of pixels flicker at 100 Hz throughout; SimError if it does not fit the view."""
    x0, y0 = _corner(view, size_px, "a lamp", rng)
    starts_s = np.arange(np.ceil(LAMP_HZ * view.duration_s)) / LAMP_HZ
    # Up in the first half of a cycle and down in the second.
    steps_s = (np.arange(2 * LAMP_STEPS) + 0.5) / (2 * LAMP_STEPS * LAMP_HZ)
    shape = (size_px, size_px, len(starts_s), len(steps_s))
    times_s = starts_s[:, None] + steps_s + LAMP_JITTER_S * rng.standard_normal(shape)
    rows, columns, _, step = np.indices(shape, sparse=True)
    return view.events(times_s, x0 + columns, y0 + rows, step < LAMP_STEPS)


def hot_clusters(view: View, n_clusters: int, rng: np.random.Generator) -> NDArray[Any]:
    """Let clusters of 3 x 3 pixels fire without cause, all events ON."""
    pixels, counts = [], []
    for _ in range(n_clusters):
        x0, y0 = _corner(view, CLUSTER_PX, "a hot cluster", rng)
        for row, column in np.ndindex(CLUSTER_PX, CLUSTER_PX):
            rate_hz = CLUSTER_HZ * rng.lognormal(0.0, HOT_SPREAD)
            counts.append(rng.poisson(rate_hz * view.duration_s))
            pixels.append((x0 + column, y0 + row))
    x, y = np.repeat(pixels, counts, axis=0).T
    times_s = rng.uniform(0.0, view.duration_s, len(x))
    return view.events(times_s, x, y, True)


def noise(view: View, rate_hz: float, rng: np.random.Generator) -> NDArray[Any]:
    """Let every pixel fire at a rate [Hz], each polarity half of the time."""
    n = rng.poisson(rate_hz * view.width * view.height * view.duration_s)
    events = np.empty(n, EVENT_DTYPE)
    events["t"] = rng.integers(0, round(1e6 * view.duration_s), n)
    events["x"] = rng.integers(0, view.width, n)
    events["y"] = rng.integers(0, view.height, n)
    events["p"] = rng.integers(0, 2, n)
    return events


def _corner(view: View, size_px: int, what: str, rng: np.random.Generator) -> tuple[int, int]:
    """Draw the first column and row of a square that lies within the view."""
    _check_fits(view, size_px, what)
    x0 = int(rng.integers(0, view.width - size_px + 1))
    return x0, int(rng.integers(0, view.height - size_px + 1))


def _check_fits(view: View, size_px: int, what: str) -> None:
    if size_px > min(view.width, view.height):
        raise SimError(
            f"disturbance: {what} of {size_px} x {size_px} px does not fit into a view of "
            f"{view.width} x {view.height} px: make it smaller"
        )


N_BRANCHES = 12
BRANCH_RADIUS_PX = (4.0, 12.0)
SWAY_PX, SWAY_HZ = (2.0, 8.0), (0.3, 1.2)
_STEP_S = 1e-3  # step at which a branch's speed is sampled

HEIGHT_SHARE = (0.15, 0.3)  # a person's height over the view's
WIDTH_SHARE = 0.3  # a person's width over the height
WALK_PX_S = (10.0, 30.0)
EVENTS_PER_PX = 2.0  # thresholds that a person's edge passes in each pixel
_EDGE_PX = 1.0  # standard deviation of events from the edge


def branches(view: View, n_events: int, rng: np.random.Generator) -> NDArray[Any]:
    """Let clumps of leaves sway about fixed places, at event rates proportional to their speed."""
    shares = rng.multinomial(n_events, np.full(N_BRANCHES, 1.0 / N_BRANCHES))
    return np.concatenate([_branch(view, int(n), rng) for n in shares])


def people(view: View, n_people: int, rng: np.random.Generator) -> NDArray[Any]:
    """Let people walk in over the left or the right border, and on to the other one."""
    return np.concatenate([_walk(view, rng) for _ in range(n_people)])


def _branch(view: View, n_events: int, rng: np.random.Generator) -> NDArray[Any]:
    place_px = rng.uniform((0.0, 0.0), (view.width, view.height))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    sway_px = rng.uniform(*SWAY_PX) * np.array([np.cos(angle), 0.3 * np.sin(angle)])
    sway_hz, phase = rng.uniform(*SWAY_HZ), rng.uniform(0.0, 2.0 * np.pi)
    starts_s = np.arange(0.0, view.duration_s, _STEP_S)
    speed = np.abs(np.cos(2.0 * np.pi * sway_hz * starts_s + phase))
    steps = rng.choice(len(starts_s), n_events, p=speed / speed.sum())
    times_s = starts_s[steps] + rng.uniform(0.0, _STEP_S, n_events)
    moved = np.sin(2.0 * np.pi * sway_hz * times_s + phase)
    # Evenly over a disc.
    radius_px = rng.uniform(*BRANCH_RADIUS_PX) * np.sqrt(rng.random(n_events))
    around = rng.uniform(0.0, 2.0 * np.pi, n_events)
    x_px = place_px[0] + sway_px[0] * moved + radius_px * np.cos(around)
    y_px = place_px[1] + sway_px[1] * moved + radius_px * np.sin(around)
    return view.events(times_s, x_px, y_px, rng.random(n_events) < 0.5)


def _walk(view: View, rng: np.random.Generator) -> NDArray[Any]:
    """Draw one person: a dark upright box, OFF events at its leading edge, ON at its trailing."""
    height_px = view.height * rng.uniform(*HEIGHT_SHARE)
    width_px = WIDTH_SHARE * height_px
    feet_px = rng.uniform(height_px, view.height)
    walk_px_s, enters_s = rng.uniform(*WALK_PX_S), rng.uniform(0.0, 0.5 * view.duration_s)
    from_left = rng.random() < 0.5
    there_s = min(view.duration_s - enters_s, (view.width + width_px) / walk_px_s)
    n = rng.poisson(2.0 * height_px * walk_px_s * EVENTS_PER_PX * there_s)
    since_s = rng.uniform(0.0, there_s, n)
    leads = rng.random(n) < 0.5
    x_px = walk_px_s * since_s - width_px * ~leads + rng.normal(0.0, _EDGE_PX, n)
    x_px = x_px if from_left else view.width - 1 - x_px
    y_px = feet_px - height_px * rng.random(n)
    return view.events(enters_s + since_s, x_px, y_px, ~leads)


SKY_LUMINANCE, CLOUD_LUMINANCE = 0.4, 0.85  # the blue and the brightest white, as in nature
SPOTS_PX = 150.0  # size of the largest clouds; smaller ones are fainter, as in turbulence
_POWER = -11.0 / 6.0  # exponent of amplitudes over wave numbers, in two dimensions (Kolmogorov)
_COVER_STD = 0.7  # deviations from mean to clear or white: edges some 10 px wide, billows softer
_STEP_PX = 0.5  # drift from frame to frame; linear in between
_BATCH = 16  # frames in memory


def clouds(view: View, drift_px_s: float, rng: np.random.Generator) -> NDArray[Any]:
    """Let clouds drift over the view, in one direction and at one speed.

    8 m/s at a height of 600 m are 6 px/s for a lens of 432 px.
    """
    sky = cloudy_sky(view, rng)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    drift = drift_px_s * np.array([np.cos(angle), np.sin(angle)])
    n = max(2, int(np.ceil(view.duration_s * drift_px_s / _STEP_PX)))
    times_s: FloatArray = view.duration_s * np.arange(1, n + 1) / n
    first = _seen(sky, view, np.zeros((1, 2)))[0]
    chunks = (times_s[start : start + _BATCH] for start in range(0, n, _BATCH))
    frames = ((chunk, _seen(sky, view, -np.multiply.outer(chunk, drift))) for chunk in chunks)
    return slow_events(first, frames, SensorConfig(), rng, rng)


def cloudy_sky(view: View, rng: np.random.Generator) -> Float32Array:
    """Draw the luminance (side, side) of a sky, periodic both ways and larger than the view."""
    side = 2 ** int(np.ceil(np.log2(2 * max(view.width, view.height))))
    waves = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side))
    amplitudes = np.hypot(waves, 1.0 / SPOTS_PX) ** _POWER
    amplitudes[0, 0] = 0.0
    field = np.fft.irfft2(amplitudes * np.fft.rfft2(rng.standard_normal((side, side))))
    share = np.clip(0.5 + field / (2.0 * _COVER_STD * field.std()), 0.0, 1.0)
    share *= share * (3.0 - 2.0 * share)  # no crease where clear and white begin
    contrast = np.log(CLOUD_LUMINANCE / SKY_LUMINANCE)
    sky: Float32Array = (SKY_LUMINANCE * np.exp(contrast * share)).astype(np.float32)
    return sky


def _seen(sky: Float32Array, view: View, corners_px: FloatArray) -> Float32Array:
    """Cut views (n, height, width) out of the periodic sky at subpixel corners (n, 2) [px]."""
    images = np.empty((len(corners_px), view.height, view.width), np.float32)
    for image, corner in zip(images, corners_px, strict=True):
        whole = np.floor(corner).astype(np.int64)
        u, v = (corner - whole).astype(np.float32)
        columns = np.arange(whole[0], whole[0] + view.width + 1) % len(sky)
        rows = np.arange(whole[1], whole[1] + view.height + 1) % len(sky)
        near = sky[np.ix_(rows, columns)]
        across = (1.0 - u) * near[:, :-1] + u * near[:, 1:]
        image[:] = (1.0 - v) * across[:-1] + v * across[1:]
    return images


# Branches of the seed, beside those of `sim.recording`: each disturbance has a stream of its own,
# so that one more leaves the others as they are.
_STREAM = 2
_SECOND, _INTRINSICS = 0, 1
# What draws each kind of clutter, by the field with its amount. Their streams follow in this order.
_CLUTTER: dict[str, Callable[..., NDArray[Any]]] = {
    "lamp_px": lamp,
    "hot_clusters": hot_clusters,
    "noise_hz": noise,
    "branches": branches,
    "people": people,
    "clouds_px_s": clouds,
}


def second_seed(seed: int) -> int:
    """Return the seed of the second object's flight, of a recording with this seed."""
    branch = np.random.SeedSequence(seed, spawn_key=(_STREAM, _SECOND))
    return int(branch.generate_state(1)[0])


def clutter(config: DisturbConfig, view: View, seed: int, camera: int) -> NDArray[Any]:
    """Draw the events of all clutter in one camera's view, except those of a second object.

    They are in order of time, on the scene's clock. The camera's index selects its random numbers.
    """
    streams = []
    for stream, (field, draw) in enumerate(_CLUTTER.items(), start=_INTRINSICS + 1):
        if amount := getattr(config, field):
            streams.append(draw(view, amount, generator(seed, _STREAM, stream, camera)))
    return merged(*streams)


def thinned(events: NDArray[Any], share: float, seed: int, camera: int) -> NDArray[Any]:
    """Keep a share of the events of a second object, drawn at random."""
    return events[generator(seed, _STREAM, _SECOND, camera).random(len(events)) < share]


def merged(*streams: NDArray[Any]) -> NDArray[Any]:
    """Merge streams of events in order of time; at equal times, earlier streams come first."""
    events = np.concatenate([np.empty(0, EVENT_DTYPE), *streams])
    order = np.argsort(events["t"], kind="stable")
    return np.take(events, order)


def wrong_intrinsics(
    K: FloatArray, config: DisturbConfig, seed: int, camera: int
) -> tuple[FloatArray, FloatArray]:
    """Draw an erroneous K (3, 3) [px]; return it and the deviations (4,) of fu, fv, pu, pv [px]."""
    percent, centre_px = config.intrinsics_error
    focal = 0.01 * percent
    deviations_px = np.array([focal * K[0, 0], focal * K[1, 1], centre_px, centre_px])
    errors_px = deviations_px * generator(seed, _STREAM, _INTRINSICS, camera).standard_normal(4)
    wrong = K.copy()
    wrong[[0, 1, 0, 1], [0, 1, 2, 2]] += errors_px
    return wrong, deviations_px


def record_disturbed(
    config: SimConfig,
    disturb: DisturbConfig,
    seed: int,
    out_dir: Path,
    provenance: dict[str, Any],
    text: bool = False,
    progress: Progress = unseen,
    write_more: WriteMore | None = None,
) -> Recorded:
    """Simulate one flight, spoil it and write it as a folder; unlike `record`, all in memory.

    truth.json has the disturbances and the true intrinsics within its provenance. SimError as for
    `record`, when a disturbance does not fit, or for a second object with a trajectory file.
    """
    check_out_dir(out_dir)
    if disturb.second_object and config.trajectory_file is not None:
        raise SimError(
            "the second object flies at random, but the trajectory is a file's, which both would "
            "fly: leave out one of them"
        )
    if disturb.second_object and config.effects.frame_gap_s and config.frames.rate_hz:
        raise SimError(
            "the second object's events would fill the gaps in which frames are read out: set "
            "frame_gap_s to 0 (--effect frame_gap_s=0), or leave the second object out"
        )
    view = View(*config.resolution, 0.0)
    _check_fits(view, disturb.lamp_px, "a lamp")
    _check_fits(view, CLUSTER_PX * bool(disturb.hot_clusters), "a hot cluster")
    n_flights = 2 if disturb.second_object else 1
    recording = simulate(config, seed, lambda share: progress(share / n_flights))
    second = None
    if disturb.second_object:
        without_frames = replace(config, frames=FrameConfig(rate_hz=0.0))
        second = simulate(
            without_frames, second_seed(seed), lambda share: progress((1 + share) / 2)
        )
    recording = disturbed(recording, disturb, seed, second)
    cameras = recording.cameras
    true = {one.camera.name: one.camera.K.tolist() for one in cameras}
    spoilt = {"disturbances": asdict(disturb), "true_K": true}
    known = [wrong_intrinsics(one.camera.K, disturb, seed, k) for k, one in enumerate(cameras)]
    return save_recording(recording, out_dir, provenance | spoilt, text, known, write_more)


def disturbed(
    recording: Recording, disturb: DisturbConfig, seed: int, second: Recording | None = None
) -> Recording:
    """Add clutter to the cameras' events; frames, rig and truth stay.

    `second` is another flight of the same configuration; a share of its events is added.
    """
    truth = recording.truth
    cameras = []
    for index, camera in enumerate(recording.cameras):
        model = camera.camera
        view = View(model.width, model.height, float(truth.times_s[-1]))
        added = clutter(disturb, view, seed, index)
        if index == 1:
            added["t"] += truth.drift.added_us(added["t"])
        added["t"] += round(1e6 * model.time_offset_s)
        streams = [camera.events, added]
        if second is not None:
            others = second.cameras[index].events
            streams.append(thinned(others, disturb.second_object, seed, index))
        cameras.append(CameraRecording(model, merged(*streams), camera.frames))
    return replace(recording, cameras=tuple(cameras))
