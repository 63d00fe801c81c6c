"""Events compared with those of a denser rendering, and the cells of the comparison."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.lab.results import Results, csv_text
from experiments.studies import fidelity
from sim.sensor.kernels import EVENT_DTYPE


def changed(events: np.ndarray, of: slice = slice(None), **steps: int) -> np.ndarray:
    """Return a copy in which fields of some events are increased, or polarities inverted."""
    events = events.copy()
    for name, step in steps.items():
        events[name][of] = 1 - events[name][of] if name == "p" else events[name][of] + step
    return events


@pytest.mark.parametrize(
    ("made", "late_us", "spurious", "missing"),
    [
        (lambda e: e, 0, 0.0, 0.0),
        (lambda e: changed(e, t=120), 120, 0.0, 0.0),
        # 100 more events, at pixels without events in the reference
        (lambda e: np.concatenate([e, changed(e[:100], x=200)]), 0, 100 / 2100, 0.0),
        (lambda e: e[500:], 0, 0.0, 500 / 2000),
        (lambda e: changed(e, slice(1, None), p=1), 0, 1999 / 2000, 1999 / 2000),
    ],
    ids=["the same", "late", "more", "fewer", "other polarity"],
)
def test_events_are_compared_with_their_counterparts(made, late_us, spurious, missing) -> None:
    """Events of one pixel and polarity are at least two match windows apart."""
    n, rng = 2000, np.random.default_rng(0)
    events, pixels = np.zeros(n, EVENT_DTYPE), rng.permutation(np.arange(n) % 400)
    events["x"], events["y"], events["p"] = pixels % 20, pixels // 20, rng.integers(0, 2, n)
    turn = pd.Series(pixels).groupby(pixels).cumcount()
    events["t"] = 50 * pixels + 3 * fidelity.MATCH_WINDOW_US * turn
    events = np.sort(events, order="t")
    result = fidelity.compare_events(np.sort(made(events), order="t"), events)
    assert (result.median_us, result.p95_us) == (late_us, late_us)
    assert (result.spurious, result.missing) == pytest.approx((spurious, missing))


def test_renderers_are_compared_on_the_same_flights_without_a_body() -> None:
    for cell in fidelity.renderer_cells():
        render = cell.reference.render
        assert render == replace(cell.sim.render, renderer="pyrender") != cell.sim.render
        assert not cell.estimator.rules.tangency.joins_body


def test_a_mark_that_is_missed_at_one_duration_is_named() -> None:
    table = pd.DataFrame({column: [most, 0.5 * most] for column, most in fidelity.MARKS.items()})
    for missed, said in (([], "met"), (["spurious"], "**not met** (spurious)")):
        table.loc[1, missed] = 0.06
        assert fidelity.verdict(Results(Path(), {"fidelity.csv": csv_text(table)})) == said
