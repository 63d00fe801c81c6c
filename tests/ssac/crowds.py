"""Recordings of a camera that sees several synthetic flights at once."""

import numpy as np

from ssac.events import EVENT_DTYPE
from tests.ssac.synthetic import HEIGHT, WIDTH, make_events, make_scene

T_D_S, DURATION_S, SIZE_M = 0.05, 8.0, 0.4


def flight(seed, share=1.0, angle_deg=90.0):
    """Events of both cameras of one flight, a share of the ordinary number."""
    scene = make_scene(seed, angle_deg, DURATION_S)
    return make_events(scene, seed, T_D_S, 25_000.0 * share, SIZE_M)


def mixed(*streams):
    """One camera's events of several things, and which thing each is of."""
    events = np.concatenate(streams)
    thing = np.repeat(np.arange(len(streams)), [len(stream) for stream in streams])
    order = np.argsort(events["t"], kind="stable")
    return events[order], thing[order]


def branches(seed, n_branches=4, rate_hz=20_000.0):
    """Events of things that sway a few pixels about their places."""
    rng = np.random.default_rng((seed, 2))
    n = int(rate_hz * DURATION_S)
    times_s, branch = np.sort(rng.uniform(0.0, DURATION_S, n)), rng.integers(n_branches, size=n)
    places = rng.uniform([40, 40], [WIDTH - 40, HEIGHT - 40], (n_branches, 2))
    sways = rng.uniform(2.0, 6.0, (n_branches, 2))
    phases = 2.0 * np.pi * (0.8 * times_s + branch / n_branches)
    points = places[branch] + sways[branch] * np.sin(phases)[:, None] + rng.normal(0, 5, (n, 2))
    events = np.zeros(n, EVENT_DTYPE)
    events["t"] = np.rint(1e6 * times_s)
    events["x"], events["y"] = np.rint(points).T
    return events
