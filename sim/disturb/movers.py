"""A view in; the events of what moves in it beside the drone out: branches and people.

They are drawn in the image, in each camera by itself: no two views of them show one thing.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.disturb.pixels import View

N_BRANCHES = 12
BRANCH_RADIUS_PX = (4.0, 12.0)
SWAY_PX, SWAY_HZ = (2.0, 8.0), (0.3, 1.2)
_STEP_S = 1e-3  # of the course of a branch

HEIGHT_SHARE = (0.15, 0.3)  # of a person, of the view's height
WIDTH_SHARE = 0.3  # of a person's height
WALK_PX_S = (10.0, 30.0)
EVENTS_PER_PX = 2.0  # thresholds that a person's edge passes in each pixel
_EDGE_PX = 1.0  # deviation of events from the edge


def branches(view: View, n_events: int, rng: np.random.Generator) -> NDArray[Any]:
    """Let clumps of leaves sway about fixed places, and fire as fast as they move.

    Parameters
    ----------
    view
    n_events
        Of all of them; those that sway out of the view are lost.
    rng
    """
    shares = rng.multinomial(n_events, np.full(N_BRANCHES, 1.0 / N_BRANCHES))
    return np.concatenate([_branch(view, int(n), rng) for n in shares])


def people(view: View, n_people: int, rng: np.random.Generator) -> NDArray[Any]:
    """Let people walk in over the left or the right border, and on to the other one."""
    walks = [_walk(view, rng) for _ in range(n_people)]
    return np.concatenate([view.events(*(np.empty(0),) * 3, np.empty(0, bool)), *walks])


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
    """One person: a dark upright box, whose leading edge darkens what the trailing one frees."""
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
