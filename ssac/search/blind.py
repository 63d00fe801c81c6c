"""The times of a camera's events in, when its whole sensor was blind out.

A camera that takes frames beside events, as a DAVIS does, loses all events while it reads a frame
out: 5 to 25 ms, some ten times a second. A recording need not say so, but its events do: busy times
are cut off and begin anew, for spans that are all as long, in one rhythm. An object that comes to
rest, or whose edges cross rows of pixels all at once, is silent too, but never so evenly.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Spans = NDArray[np.int64]

_SHORTEST_US, _LONGEST_US = 3_000, 30_000  # of a readout
_BESIDE_US = 5_000  # on each side of a silence, where there must be many events
_EXPECTED = 20.0  # events that a silence would hold at their rate: by chance it holds some
_LEAST = 10  # silences that make a rhythm
_MOST_PERIODS = 10  # from one of them to the next: in between, the object may hardly move
_SAME_LENGTH, _SAME_RHYTHM = 0.2, 0.05  # shares by which lengths, and beats, differ at the most
_MOST_OTHERS = 0.2  # share of the silences of that length that are off the beat
_MOST_LENGTHS = 0.4  # share of the silences of another length: an object's own, in volleys
_MOST_SHARE = 0.6  # of a period, in which a camera that is of use is blind
_MOST_INSIDE = 0.02  # events within spans, as a share of what they would hold
_LEAST_CUT = 0.5  # share of the events that lie between spans of the rhythm


def no_spans() -> Spans:
    """Give the spans (0, 2) of a camera that is never blind."""
    return np.empty((0, 2), np.int64)


@dataclass(frozen=True)
class Blind:
    """When a camera was blind."""

    spans_us: Spans = field(default_factory=no_spans)  # (g, 2) [us] in its clock, ascending
    period_s: float = np.nan  # from one to the next; NaN of none


def blind_spans(times_us: NDArray[np.int64]) -> Blind:
    """Find the readouts of frames among the times of events.

    Parameters
    ----------
    times_us
        Shape (n,) [us], sorted.

    Returns
    -------
    Blind
        Without spans unless most of the events lie in one rhythm of silences.
    """
    silences_us = _sudden_silences(times_us)
    if len(silences_us) < _LEAST:
        return Blind()
    lengths_us = np.diff(silences_us)[:, 0]
    length_us = float(np.median(lengths_us))
    alike = np.abs(lengths_us - length_us) <= _SAME_LENGTH * length_us
    if np.mean(alike) < 1.0 - _MOST_LENGTHS:
        return Blind()
    spans_us = silences_us[alike]
    since_us = np.diff(spans_us[:, 0])
    period_us = float(np.median(since_us))
    beats = np.rint(since_us / period_us)
    near = (beats >= 1.0) & (beats <= _MOST_PERIODS)
    if np.count_nonzero(near) < _LEAST - 1 or length_us > _MOST_SHARE * period_us:
        return Blind()
    period_us = float(np.sum(since_us[near]) / np.sum(beats[near]))
    on_beat = np.abs(since_us - beats * period_us) <= _SAME_RHYTHM * period_us
    if np.mean(on_beat[near]) < 1.0 - _MOST_OTHERS:
        return Blind()
    chained = near & on_beat
    spans_us = _filled(spans_us, np.where(chained, beats, 0.0).astype(np.intp))
    return Blind(spans_us, 1e-6 * period_us) if _cut(times_us, spans_us, period_us) else Blind()


def _sudden_silences(times_us: NDArray[np.int64]) -> Spans:
    """Find the silences (g, 2) of busy times, too long for chance."""
    at = np.flatnonzero(np.diff(times_us) >= _SHORTEST_US)
    starts_us, ends_us = times_us[at], times_us[at + 1]
    before = at + 1 - np.searchsorted(times_us, starts_us - _BESIDE_US)
    after = np.searchsorted(times_us, ends_us + _BESIDE_US, side="right") - (at + 1)
    lengths_us = ends_us - starts_us
    expected = np.minimum(before, after) * lengths_us / _BESIDE_US
    sudden = (lengths_us <= _LONGEST_US) & (expected >= _EXPECTED)
    return np.asarray(np.column_stack([starts_us, ends_us])[sudden])


def _filled(spans_us: Spans, beats: NDArray[np.intp]) -> Spans:
    """Add the spans between those that are several beats apart."""
    parts = [spans_us]
    for k in np.flatnonzero(beats > 1):
        step_us = (spans_us[k + 1] - spans_us[k]) / beats[k]
        since_us = np.rint(step_us * np.arange(1, beats[k])[:, None])
        parts.append(spans_us[k] + since_us.astype(np.int64))
    joined = np.concatenate(parts)
    return joined[np.argsort(joined[:, 0])]


def _cut(times_us: NDArray[np.int64], spans_us: Spans, period_us: float) -> bool:
    """Whether next to no events lie within the spans, and most lie between them."""
    lengths_us = np.diff(spans_us)[:, 0]
    middles_us = spans_us + np.outer(lengths_us // 10, [1, -1])  # ends are not to the microsecond
    inside = np.sum(np.diff(np.searchsorted(times_us, middles_us)))
    within = np.diff(spans_us[:, 0]) <= 1.5 * period_us
    bounds = np.searchsorted(times_us, spans_us[:, 0])
    n_cut = np.sum(np.diff(bounds)[within])
    expected = n_cut * float(np.median(lengths_us)) / period_us
    return bool(inside <= _MOST_INSIDE * expected and n_cut >= _LEAST_CUT * len(times_us))
