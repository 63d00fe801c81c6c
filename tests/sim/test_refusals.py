"""Tests that invalid values are refused in one line that says what was expected, and what came."""

from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from sim.disturb import DisturbConfig
from sim.effects.config import SensorEffects
from sim.errors import SimError
from sim.recorded import drift_of
from sim.recording import SimConfig, simulate
from sim.render.config import RenderConfig, SamplingConfig
from sim.render.footprint import footprint
from sim.render.gl_context import open_context
from sim.render.lattice import Lattice
from sim.scene.background import load_background, uniform_background
from sim.scene.drone import drone_from_file
from sim.scene.flyers import bird, built_in_drone, quadrotor
from sim.scene.rig import two_view_rig
from sim.scene.trajectory import SplineConfig, random_spline, trajectory_from_csv
from sim.sensor.events import SensorConfig, events_from_frames
from sim.sensor.frames import FrameConfig
from sim.twin.bench import TwinConfig, bench_rig, printed
from sim.twin.calibration import CalibrationConfig, calibrated_camera
from sim.twin.pendulum import PendulumConfig, hanging
from sim.twin.room import RoomConfig
from tests.sim.scenes import QUICK, box_drone, lens, make_camera, poses, rng

NAN, INF = float("nan"), float("inf")
GREY = np.full((3, 4, 5), 0.5)
STEADY = np.arange(3.0)
POSITIVE = {
    SensorConfig: ("threshold_on", "threshold_off", "log_eps"),
    SplineConfig: ("duration_s", "sampling_hz", "segments_per_s", "smoothing"),
    SamplingConfig: ("max_step_px", "min_rate_hz"),
    PendulumConfig: ("length_m", "hand_hz", "twist_hz", "rocking_hz", "max_radius_m"),
    SensorEffects: ("illuminance_lux", "cutoff_max_hz", "flicker_hz"),
}
NUMBERS = [
    (FrameConfig, "rate_hz"),
    (CalibrationConfig, "corner_std_px"),
    *(
        (config, one.name)
        for config in (SensorConfig, SensorEffects, DisturbConfig, PendulumConfig, RoomConfig)
        for one in fields(config)
        if isinstance(one.default, (int, float))
    ),
]


RADTAN, FISHEYE = "radtan", "equidistant"
FOLDED = [lens(RADTAN, -0.4, 0, 0, 0), lens(RADTAN, 0, 0, 0.5, 0), lens(FISHEYE, -1, 0, 0, 0)]


def grey_with(light, shape=(48, 64), place=(3, 4)):
    """An array of 0.5 but for one place."""
    grey = np.full(shape, 0.5)
    grey[place] = light
    return grey


CASES = [
    # Numbers that must not be negative, and those that must be positive.
    *((partial(config, **{name: value}), rf"{name} .*(0|positive).* got {value}")
      for config, name in NUMBERS for value in (-0.1, NAN, INF)),
    *((partial(config, **{name: value}), f"{name} must be (0 or )?a positive number, got {value}")
      for config, names in POSITIVE.items() for name in names for value in (0.0, NAN)),
    (lambda: SensorConfig(hot_pixel_share=1.5), "hot_pixel_share is a share of 1"),
    *((lambda e=e: FrameConfig(50.0, e), r"at most 1 / rate_hz = 0\.02 s")
      for e in (0, 0.021, NAN)),
    *((lambda s=s: events_from_frames(np.zeros(s), STEADY), r"expected an array \(n, height, width")
      for s in ((3, 4), (3, 4, 5, 3), (2, 4, 5), (1, 4, 5))),
    *((lambda t=t: events_from_frames(GREY, np.array(t)), "times must be finite and increase")
      for t in ([0, 2, 1], [0, 1, 1], [0, NAN, 2], [0, 1, INF])),
    *((lambda v=v, k=k: events_from_frames(grey_with(v, GREY.shape, (k, 1, 2)), STEADY),
       r"linear intensities in \[0, 1\]") for v in (-0.01, 1.01, NAN, INF) for k in (0, 2)),
    (lambda: SensorEffects(cutoff_min_hz=9e3), "cutoff_min_hz must be at most cutoff_max_hz"),
    (lambda: SensorEffects(flicker_depth=1.0), "flicker_depth must be less than 1"),
    (lambda: SensorEffects(frame_phase_spread=1.5), "frame_phase_spread is a share"),
    (lambda: SensorEffects(readout_queue=0), "readout_queue must be 1 or more"),
    (lambda: SimConfig(frames=FrameConfig(25.0), effects=SensorEffects(frame_gap_s=0.04)),
     r"frame_gap_s must be less than 1 / rate_hz .* 0.04 s"),
    (lambda: DisturbConfig(second_object=1.5), "second_object is a share, 0 to 1, got 1.5"),
    (lambda: DisturbConfig(intrinsics_error=(11.0, 0.0)), "intrinsics_error needs 0 to 10 %"),
    (lambda: drift_of(NAN, None, 10.0), "clock skew: expected"),
    (lambda: drift_of(2e5, None, 10.0), "got 200000"),
    (lambda: drift_of(0.0, (0.0, 0.1), 10.0), "within the flight, 0 to 10 s"),
    (lambda: drift_of(0.0, (10.0, 0.1), 10.0), "got 10"),
    (lambda: drift_of(0.0, (5.0, -0.02), 10.0), "above 0 s, got -0.02: stamps of a clock that is"),
    (lambda: drift_of(0.0, (5.0, NAN), 10.0), "above 0 s"),
    *((lambda n=n, s=s: built_in_drone(n, s), "size must be a positive number of metres")
      for n in ("quadrotor", "two-tone", "bird", "plane") for s in (0.0, -1.0, NAN)),
    (lambda: printed(-1.0), "size must be a positive number of metres, got -1"),
    (lambda: quadrotor(rotor_hz=INF), "rate must be a finite number"),
    (lambda: bird(flap_hz=INF), "wings' rate must be a finite number"),
    (lambda: SimConfig(drone="hawk"), "one of quadrotor, two-tone, bird, plane, got 'hawk'"),
    *((lambda n=n: built_in_drone(n, rotor_hz=20.0),
       rf"on the built-in quadrotors only \(quadrotor, two-tone\), not on a {n}")
      for n in ("bird", "plane")),
    (lambda: SplineConfig(order=2), "order must be at least 3, got 2"),
    (lambda: SplineConfig(duration_s=0.2), "fewer than 2 poses"),
    (lambda: SplineConfig(multiplier_xyz_m=(1.0, NAN, 1.0)), "multiplier_xyz_m must be three fini"),
    (lambda: random_spline(SplineConfig(6.0, max_radius_m=0.1), rng()),
     r"all went more than 0\.1 m away.*lower multiplier_xyz_m"),
    *((lambda t=t: random_spline(SplineConfig(6.0), rng()).poses(np.array([1.0, t])),
       "defined from 0 to 6 s") for t in (-1e-6, 6.000001, NAN)),
    *((lambda a=a: two_view_rig(a), "must be between 0 and 180 deg, exclusive")
      for a in (0.0, 180.0, -30.0, 270.0, NAN)),
    (lambda: two_view_rig(90.0, t_d_s=NAN), "time offset must be a finite number of seconds"),
    (lambda: two_view_rig(90.0, distance_m=0.0), "distance must be positive, got 0"),
    (lambda: two_view_rig(90.0, focal_px=-1.0), "focal lengths and resolution must be positive"),
    (lambda: two_view_rig(90.0, resolution=(0, 260)), "focal lengths and resolution must be"),
    (lambda: two_view_rig(90.0, principal_point=(NAN, 130.0)), "cam1: K and T_C_W must be finite"),
    (lambda: two_view_rig(90.0, distortion_model="fov"), "'fov': use one of none, radtan"),
    (lambda: two_view_rig(90.0, distortion_coeffs=(0.1,) * 4), "'none' needs 0 finite coeff"),
    (lambda: two_view_rig(90.0, **lens(FISHEYE, 0.1, 0, 0, NAN)), "'equidistant' needs 4 finite"),
    *((partial(two_view_rig, 90.0, **folded), r"cam1: the .* fold the image back on itself")
      for folded in FOLDED),
    # The first image folds on a ring of 122 px about the principal point, here outside of it: the
    # ring crosses the right and lower half alone.
    (lambda: two_view_rig(90.0, resolution=(130, 100), principal_point=(5.0, -30.0), **FOLDED[0]),
     "fold the image back on itself"),
    *((lambda v=v: uniform_background(make_camera(), v), "background luminance: expected 0 to 1")
      for v in (-0.01, 1.01, NAN)),
    *((lambda a=a, b=b: Lattice(a, b), "expected 1 <= a <= 31 and b = 0 or 1")
      for a, b in ((0, 0), (32, 0), (8, 2), (8, -1))),
    (lambda: RenderConfig(renderer="blender"), "'blender': use one of native, pyrender"),
    *((lambda s=s: RenderConfig(ambient=s), "ambient light: expected 0 to 1")
      for s in (-0.1, 1.1, NAN)),
    (lambda: RenderConfig(backend="foo", check=False), "expected auto, osmesa or egl, got 'foo'"),
    *((lambda d=d: RenderConfig(light_W=d), "light_W: expected a finite direction")
      for d in ((0.0, 0.0, 0.0), (NAN, 0.0, 1.0))),
    *((lambda b=b: open_context(b), "GL backend: expected auto, osmesa or egl, got")
      for b in ("", "OSMESA", "wayland")),
    (lambda: TwinConfig(distances_m=(0.5, -0.1)), "distances_m must be two positive numbers"),
    (lambda: TwinConfig(**lens(FISHEYE)), "lenses of the model radtan or none, got equidistant"),
    (lambda: RoomConfig(shadow=1.0), "shadow is a share, 0 to less than 1, got 1"),
    (lambda: PendulumConfig(hand_m=(0.1, NAN, 0.0)), "hand_m must be three numbers"),
    (lambda: hanging(PendulumConfig(max_radius_m=0.001), 2.0, rng()),
     r"all went more than 0.001 m away.*lower hand_m"),
    (lambda: CalibrationConfig(n_views=2), "a board of 3 x 3 corners or more and 3 views or more"),
    (lambda: calibrated_camera(BENCH.cameras[0], CalibrationConfig(square_m=0.5), rng()),
     "too few are in view, of cam1 or of both: take a smaller one"),
    *((lambda c=c: simulate(replace(QUICK, **c), 1), text) for c, text in (
        ({"background_files": (Path("a"), Path("b"), Path("c"))}, "expected one image"),
        ({"drone_file": Path("missing.stl"), "drone_size_m": 0.0}, "number of metres, got 0"),
        ({"distance_m": 0.5}, "reaches into the camera"),
        ({"drone_size_m": 20.0}, r"--distance\), or take a drone smaller than 20 m \(--drone-size"),
    )),
    (lambda: simulate(QUICK, -1), "seed: expected 0 or a positive integer, got -1"),
    # The drone, 4 m wide and 0.1 m before a lens of 5000 px, reaches 100,000 px beside the view.
    (lambda: footprint(box_drone((4.0, 0.05, 0.05)), two_view_rig(90.0, focal_px=5e3).cameras[0],
                       np.zeros(1), poses(np.array([[0.0, -4.9, 0.0]]))),
     "reaches into the camera"),
]  # fmt: skip
BENCH = bench_rig(TwinConfig())


@pytest.mark.parametrize(("ask", "message"), CASES)
def test_what_makes_no_sense_is_refused(ask, message, monkeypatch):
    monkeypatch.setattr("sim.twin.calibration.MAX_TRIES", 100)
    with pytest.raises(SimError, match=message):
        ask()


@pytest.mark.parametrize("folded", FOLDED)
def test_a_narrow_view_never_reaches_the_fold(folded):
    two_view_rig(90.0, focal_px=2000.0, **folded)


LOST_VERTEX = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n"
)
MESHES = [
    ("mesh.ply", LOST_VERTEX, "faces whose vertices are missing"),
    ("mesh.stl", None, "does not exist"),
    ("mesh.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "has no faces"),
    ("mesh.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
    ("mesh.obj", "v 0 0 0\nv 0 0 1\nv 0 0 2\nf 1 2 3\n", "no extent along x or y"),
    ("mesh.stl", "not a mesh", "has no faces"),
    ("mesh.docx", "not a mesh", "cannot read the drone's mesh"),
]
SIZE, LIGHT = "expected 64 x 48 pixels .* resize", r"expected linear luminance in \[0, 1\]"
UNREAD = "cannot read the background .*"
WALLS = [
    *(("wall.npy", np.zeros(shape), SIZE) for shape in ((48, 63), (64, 48), (48, 64, 3))),
    *(("wall.npy", grey_with(light), LIGHT) for light in (-0.1, 1.1, NAN, INF)),
    *(("wall.npy", np.array(odd), "wall") for odd in (["a"] * 4, [None])),
    *(("missing" + suffix, None, UNREAD) for suffix in (".png", ".npy")),
    *(("text" + suffix, b"neither image nor array", UNREAD) for suffix in (".png", ".npy")),
    ("empty.npy", b"", UNREAD),
    ("complex.npy", np.zeros((48, 64), complex), UNREAD),
    ("records.npy", np.zeros((48, 64), [("light", "f8")]), UNREAD),
    ("two.npy", (grey_with(0.5), grey_with(0.5)), UNREAD),
]
ROW = "{},{},0,1,0,0,0,1\n"  # t, x
GOOD = [ROW.format(t, 0) for t in (0.0, 0.1, 0.2, 0.3)]
PATHS = [
    ("path.csv", "".join(lines), said)
    for lines, said in (
        ([*GOOD, ROW.format(0.25, 0)], r"line 5: times must increase.*0\.25 s follows 0\.3 s"),
        ([*GOOD, GOOD[-1]], r"line 5: times must increase.*drop repeats"),
        ([*GOOD, ROW.format("nan", 0)], r"line 5: expected 8 finite numbers.*got nan"),
        ([*GOOD, ROW.format("", 0)], r"line 5: expected 8 finite numbers.*correct or delete"),
        ([*GOOD, "0.4,1,2,3\n"], r"line 5: expected 8 finite numbers"),
        ([*GOOD, "0.4,0,0,0,0,0,0,0\n"], r"line 5: the quaternion .* is zero"),
        (GOOD[:3], r"expected 4 rows or more of t, x.*got 3"),
        ([], r"expected 4 rows or more of t, x.*got 0"),
        (["t,x,y,z,qx,qy,qz\n", *GOOD], r"line 1: the header lacks qw"),
        ([ROW.format(t * 10**8, 0) for t in range(20)], r"must be in seconds.*divide by 1e9"),
    )
]
READERS = {
    drone_from_file: MESHES,
    lambda path: load_background(path, make_camera(resolution=(64, 48))): WALLS,
    trajectory_from_csv: PATHS,
}


@pytest.mark.parametrize(
    ("read", "name", "holds", "said"),
    [(read, *file) for read, files in READERS.items() for file in files],
)
def test_a_file_that_is_no_use_is_refused(tmp_path, read, name, holds, said):
    path = tmp_path / name
    if isinstance(holds, np.ndarray):
        np.save(path, holds)
    elif isinstance(holds, tuple):
        with path.open("wb") as file:
            np.savez(file, *holds)
    elif holds is not None:
        path.write_bytes(holds if isinstance(holds, bytes) else holds.encode())
    with pytest.raises(SimError, match=said) as error:
        read(path)
    assert name in str(error.value)
