"""
A guided tour
=============

Two event cameras watch one drone. Their clocks differ by an unknown offset `t_d`, and it is not
known how the cameras stand to each other. This tour makes such a recording, finds both, meets a
recording that cannot tell, and ends with a method of your own. It is a script, `docs/tour/tour.py`:
run it as it is, open its cells in an editor that knows `# %%`, or let `make docs` run it and show
what it prints.

1. A recording whose truth is known
-----------------------------------

An event camera has no frames. Each pixel reports, with microseconds, when its brightness has
changed by some factor. `simulate` flies a drone on a random path, renders it for both cameras,
and turns the brightness of each pixel into events. The lines of sight differ by 90 degrees, and
camera 2's clock shows 50 ms more: `t_cam2 = t_cam1 + t_d`.
"""

from sim.recording import SimConfig, simulate
from sim.scene.trajectory import SplineConfig
from sim.sensor.frames import FrameConfig

no_frames = FrameConfig(rate_hz=0.0)
config = SimConfig(angle_deg=90, t_d_s=0.05, spline=SplineConfig(duration_s=6), frames=no_frames)
recording = simulate(config, seed=1)
for name, camera in zip(("camera 1", "camera 2"), recording.cameras, strict=True):
    print(name, len(camera.events), "events; the first is", camera.events[0])

# %%
# 2. The offset and the pose
# --------------------------
#
# A method gets what real cameras would give: both streams of events, and the intrinsics of both
# cameras, which are focal length and principal point. It does not get the truth. `ssac.sync` does
# what the command `ssac sync` does. `tangency`, its default, follows the drone in both streams,
# tries offsets until the two tracks obey one epipolar geometry, and then refines offset and pose
# together.

import ssac
from experiments.lab.recorded import observations, rig_of

cam1, cam2 = observations(recording)
rig = rig_of(recording)  # intrinsics only
result = ssac.sync(cam1, cam2, rig)  # or the names of three files
print("status", result.status)
print(result.summary())

# %%
# The status says whether the numbers are to be trusted, and the deviations, "1 sigma", how far. As
# this recording was simulated we can see for ourselves: `scored` sets an estimate beside the truth.

from experiments.lab.score import Truth, scored

flown = recording.truth
truth = Truth(flown.t_d_s, flown.R, flown.t)
estimate = result.estimate
errors = scored(estimate, truth)
print(f"offset off by {errors['t_d_error_ms']:.3f} ms")
print(f"R off by {errors['r_error_deg']:.3f} deg, t by {errors['t_error_deg']:.3f} deg")

# %%
# `report` writes all of it as `one page <report.html>`_ with a player of both streams, which needs
# no other file and can be sent to somebody; `ssac sync --report` does the same.

print(result.report("report.html"))

# %%
# 3. What the method saw
# ----------------------
#
# For each candidate offset, the mean distance between the drone in one image and the epipolar line
# of where it was in the other. Where the offset is wrong, camera 2 shows the drone at another time,
# and no geometry fits; at the true offset, the dashed line, the distance is least.

import matplotlib.pyplot as plt
import numpy as np

from experiments.drawing.events import CAMERAS

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), dpi=200, layout="constrained")
left.plot(1e3 * estimate.candidates_s, estimate.costs, ".-", color="black", markersize=3)
left.axvline(1e3 * truth.t_d_s, color="0.5", linestyle="--")
left.set(xlabel="candidate offset [ms]", ylabel="mean epipolar distance [px]")
for name, camera, color in zip(("camera 1", "camera 2"), (cam1, cam2), CAMERAS, strict=True):
    some = camera.events[:: len(camera.events) // 4000]
    right.plot(some["t"] / 1e6, some["y"], ".", color=color, markersize=1, label=name)
right.invert_yaxis()
right.set(xlabel="time on the camera's own clock [s]", ylabel="image row of events [px]")
legend = right.legend(markerscale=10)

# %%
# 4. A recording that cannot tell
# -------------------------------
#
# Let something fly in a circle at a constant speed. A wrong offset is then a turned pose: the two
# views can be made to fit at any offset, and no method can know which one is right. A method that
# gave a number here would be wrong, so ours gives a status and a reason. `docs/refusal.md` lists
# all of them. In place of events, `sync` takes tracks of image positions as well, as a tracker in
# ordinary videos gives them: these are right to 0.3 pixels, 60 times a second.

from sim.scene.rig import two_view_rig
from ssac.track.observation import tracked

times_s = np.arange(0, 8, 1 / 60)
angles = 2 * np.pi * times_s
circle_m = 0.8 * np.column_stack([np.cos(angles), 0.8 * np.sin(angles), 0.6 * np.sin(angles)])
noise = np.random.default_rng(0)
tracks = []
for camera, t_d_s in zip(two_view_rig(90).cameras, (0.0, 0.05), strict=True):
    points_px = camera.project(circle_m) + noise.normal(0.0, 0.3, (len(times_s), 2))
    tracks.append(tracked(ssac.PointTrack(times_s + t_d_s, points_px)))
refused = ssac.sync(*tracks, rig)
print(refused.status)
print(refused.reason)

# %%
# 5. A method of your own
# -----------------------
#
# A method is a function of both observations, the rig and the parameters, and returns an
# `Estimate`. This one needs no geometry: cameras that stand upright both see the drone rise and
# fall, so it correlates the mean image row of the events in bins of 5 ms. `docs/methods.md` shows
# how a package of yours registers it, so that `ssac sync`, the tables and all sweeps know it.

from ssac import Config, Estimate, Observation, Rig

BIN_S = 0.005


def heights(cam1: Observation, cam2: Observation, rig: Rig, config: Config | None) -> Estimate:
    """Correlation of the mean image rows of both cameras' events, offset only."""
    low_s, high_s = (config or Config()).offsets_s
    rows1, rows2 = (mean_rows(cam.events) for cam in (cam1, cam2))
    best, found = -1.0, None
    for lag in range(round(low_s / BIN_S), round(high_s / BIN_S) + 1):
        first, last = max(0, -lag), min(len(rows1), len(rows2) - lag)
        if last - first < 1 / BIN_S:  # less than a second in common
            continue
        correlation = np.corrcoef(rows1[first:last], rows2[first + lag : last + lag])[0, 1]
        if correlation > best:
            best, found = correlation, lag
    if found is None:
        return Estimate("heights", "no_common_time", "less than a second in common")
    return Estimate("heights", "ok", t_d_s=found * BIN_S)


def mean_rows(events: np.ndarray) -> np.ndarray:
    """Mean row of the events in each bin, from time 0 on; between bins without events, a line."""
    bins = (events["t"] * 1e-6 / BIN_S).astype(int)
    counts = np.bincount(bins)
    sums = np.bincount(bins, weights=events["y"])
    seen = np.flatnonzero(counts)
    return np.interp(np.arange(len(counts)), seen, sums[seen] / counts[seen])


own = heights(cam1, cam2, rig, None)
off_ms = scored(own, truth)["t_d_error_ms"]
print(f"heights: {1e3 * own.t_d_s:.0f} ms, off by {off_ms:.1f} ms")

# %%
# It is off by as much as its bins allow, or by more where the drone leaves the view; `tangency` was
# off by the part of a millisecond that stands above. From here, `ssac simulate` and `ssac sync` do
# the same on files, and a TOML file for `ssac sweep` asks how a method fares as anything varies
# (`docs/sweeps.md`).
