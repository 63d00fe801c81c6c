"""The things that move before one camera, each followed as far as it can be.

Ordinary recordings show one thing, which a look at a few short bins of time tells. Where there are
several, the events of each bin fall into blobs: cells that hang together. Blobs are followed from
bin to bin as pieces of paths, which end where two meet or one comes apart. What stays in its place,
as a branch in the wind, is none of them: its cells are left out.
"""

from dataclasses import dataclass, field, replace

import numba
import numpy as np
from numpy.typing import NDArray

from ssac.arrays import Array, Events, IntArray, Mask, Pixels
from ssac.camera import Camera, undistort_points
from ssac.events import first_from
from ssac.rules import ObjectRules


@dataclass(frozen=True)
class Blobs:
    """Clusters of events, bin by bin."""

    bins: IntArray  # (k,) ascending
    n_events: Array  # (k,)
    centres_px: Array  # (k, 2) of the raw pixels
    sizes_px: Array  # (k,) rms
    corners_px: Array  # (k, 4) least x and y, largest x and y
    at_still: Mask  # (k,) beside something that stays in its place


@dataclass(frozen=True)
class Piece:
    """A thing's path for as long as it is alone."""

    first: int  # bin, counted from the recording's start
    positions_px: Array  # (n, 2) undistorted, one for each bin
    n_events: Array  # (n,)
    size_px: float  # median rms size of the image
    blobs: IntArray  # (n,)

    @property
    def last(self) -> int:
        """Bin after the last."""
        return self.first + len(self.positions_px)


@dataclass(frozen=True)
class Objects:
    """The things that move before one camera."""

    start_us: int  # of the first bin
    bin_us: int  # length of a bin
    are_several: bool  # not the parts of one, which keep together
    n_seen: int  # at a time, those that stay in their place included
    pieces: list[Piece]  # of those that move, in order of time
    blob_of_event: NDArray[np.int32] = field(repr=False)  # (n,) -1: of none

    def events_of(self, pieces: list[Piece]) -> Mask:
        """Tell which events (n,) belong to some of the pieces."""
        n_blobs = int(np.max(self.blob_of_event, initial=-1)) + 1
        chosen = np.zeros(n_blobs + 1, np.bool_)  # the last of none
        for piece in pieces:
            chosen[piece.blobs] = True
        return np.asarray(chosen[self.blob_of_event])


def seem_several(events: Events, camera: Camera, rules: ObjectRules) -> bool:
    """Whether more than one thing is seen at a time, by some of the bins."""
    if len(events) == 0:
        return False
    cells, bounds = _Cells.of(camera, rules), _bounds(events, rules.bin_us, rules.look_every)
    blobs, *_ = _blobs(events, bounds, cells, rules)
    n_things = _things(blobs, len(bounds), cells.size_px, rules)
    return bool(np.mean(n_things > 1) > rules.several_share)


def objects_of(events: Events, camera: Camera, rules: ObjectRules) -> Objects:
    """Follow all that moves in a camera's denoised events (n,), sorted by time."""
    cells, bounds = _Cells.of(camera, rules), _bounds(events, rules.bin_us)
    blobs, _, n_full = _blobs(events, bounds, cells, rules)
    n_things = _things(blobs, len(bounds), cells.size_px, rules)
    n_seen = int(np.quantile(n_things, 1.0 - rules.several_share))
    cells = replace(cells, still=n_full > rules.still_share * len(bounds))
    rows, columns = events["y"] // cells.size_px, events["x"] // cells.size_px
    share_still = float(np.mean(cells.still[rows, columns]))
    blobs, labels, _ = _blobs(events, bounds, cells, rules)
    paths = [path for path in _paths(blobs, len(bounds), rules) if len(path) >= rules.least_bins]
    extent_px = _extent_px(blobs, len(bounds))
    is_part = _are_parts(blobs, extent_px)
    pieces = [_piece(path, blobs, camera) for path in paths if np.mean(is_part[path]) < 0.5]
    share_apart = _bins_of_their_own_way(pieces, extent_px, rules) / len(bounds)
    # A large object fills cells for long too, but comes apart now here and now there.
    longest = max((len(piece.positions_px) for piece in pieces), default=0)
    has_still = share_still > rules.several_share and longest >= rules.lasting_bins
    are_several = has_still or share_apart > 0.5 * rules.several_share
    return Objects(int(events["t"][0]), rules.bin_us, are_several, n_seen, pieces, labels)


def _step_px(positions_px: Array) -> Array:
    """Velocity (2,) [px per bin] over positions (n, 2) of successive bins; 0 of one."""
    return np.asarray((positions_px[-1] - positions_px[0]) / max(len(positions_px) - 1, 1))


@dataclass(frozen=True)
class _Cells:
    """Squares of a sensor."""

    size_px: int
    still: Mask  # (rows, columns) in which something stays in its place

    @staticmethod
    def of(camera: Camera, rules: ObjectRules) -> "_Cells":
        """Cut a sensor into cells, none of them still."""
        size_px = max(1, round(rules.cell_widths * camera.width))
        shape = -(-camera.height // size_px), -(-camera.width // size_px)
        return _Cells(size_px, np.zeros(shape, np.bool_))


def _bounds(events: Events, bin_us: int, every: int = 1) -> IntArray:
    """First event of each `every`-th bin, and the one after its last (b, 2).

    Bins count from the first event on, so that a clock that shows more changes nothing.
    """
    times_us = events["t"]
    n_bins = int(times_us[-1] - times_us[0]) // bin_us + 1
    starts = np.arange(0, n_bins, every, dtype=np.int64)
    ends_us = times_us[0] + np.stack([starts, starts + 1], axis=1) * bin_us
    return first_from(times_us, ends_us.ravel()).reshape(ends_us.shape).astype(np.int64)


def _blobs(
    events: Events, bounds: IntArray, cells: _Cells, rules: ObjectRules
) -> tuple[Blobs, NDArray[np.int32], IntArray]:
    """Find the blobs, that of each event (n,), -1 of none, and in how many bins cells are full."""
    x, y, least = events["x"], events["y"], rules.full_cell_events
    labels, bins, at_still, n_full = _labelled(x, y, bounds, cells.size_px, cells.still, least)
    sums = _summed(x, y, bounds, labels, len(bins))
    kept = sums[:, 0] >= rules.least_blob_events
    bins, sums, at_still = bins[kept], sums[kept], at_still[kept]
    labels = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1).astype(np.int32)[labels]
    n = sums[:, 0]
    means = sums[:, 1:3] / n[:, None]
    spreads = (sums[:, 3] + sums[:, 4]) / n - means[:, 0] ** 2 - means[:, 1] ** 2
    sizes = np.sqrt(np.maximum(spreads, 0.0))
    return Blobs(bins, n, means, sizes, sums[:, 5:], at_still), labels, n_full


def _things(blobs: Blobs, n_bins: int, cell_px: int, rules: ObjectRules) -> IntArray:
    """Count the things (b,) in each bin: blobs well apart, the largest first."""
    counts = np.bincount(blobs.bins, minlength=n_bins)
    starts = np.cumsum(counts) - counts
    things = np.minimum(counts, 1)
    for b in np.flatnonzero(counts > 1):
        of_bin = np.arange(starts[b], starts[b] + counts[b])
        of_bin = of_bin[np.argsort(-blobs.n_events[of_bin], kind="stable")]
        kept = [of_bin[0]]
        for k in of_bin[1:]:
            if blobs.n_events[k] < rules.least_blob_share * blobs.n_events[kept[0]]:
                break
            own = blobs.corners_px[k]
            if all(_are_apart(own, blobs.corners_px[j], cell_px, rules) for j in kept):
                kept.append(k)
        things[b] = len(kept)
    return things


def _are_apart(one: Array, other: Array, cell_px: int, rules: ObjectRules) -> bool:
    """Whether the gap between two boxes is large beside the larger of them."""
    gap_px = float(np.max([one[:2] - other[2:], other[:2] - one[2:]]))
    larger_px = max(np.hypot(*(one[2:] - one[:2])), np.hypot(*(other[2:] - other[:2])))
    return bool(gap_px > max(rules.apart_cells * cell_px, rules.apart_sizes * larger_px))


def _extent_px(blobs: Blobs, n_bins: int) -> float:
    """Median of each bin's longest diagonal of a blob."""
    longest_px = np.zeros(n_bins)
    diagonals_px = np.hypot(*(blobs.corners_px[:, 2:] - blobs.corners_px[:, :2]).T)
    np.maximum.at(longest_px, blobs.bins, diagonals_px)
    return float(np.median(longest_px[longest_px > 0.0])) if longest_px.any() else 0.0


def _are_parts(blobs: Blobs, extent_px: float) -> Mask:
    """Tell which blobs (k,) are seen nearer to a brighter one than a whole object is long."""
    are_parts = np.zeros(len(blobs.bins), np.bool_)
    for step in range(1, int(np.max(np.bincount(blobs.bins), initial=0))):
        here, there = slice(None, -step), slice(step, None)
        apart_px = np.hypot(*(blobs.centres_px[there] - blobs.centres_px[here]).T)
        near = (blobs.bins[there] == blobs.bins[here]) & (apart_px < extent_px)
        is_fainter = blobs.n_events[there] < blobs.n_events[here]
        are_parts[there] |= near & is_fainter
        are_parts[here] |= near & ~is_fainter
    return are_parts


def _bins_of_their_own_way(pieces: list[Piece], extent_px: float, rules: ObjectRules) -> int:
    """Count the bins in which two pieces move apart, or together, as parts of one do not."""
    n = 0
    for k, other in enumerate(pieces):
        for one in pieces[:k]:
            first, last = max(one.first, other.first), min(one.last, other.last)
            if last - first < rules.least_bins:
                continue
            gaps_px = (
                one.positions_px[first - one.first : last - one.first]
                - other.positions_px[first - other.first : last - other.first]
            )
            moved_px = float(np.hypot(*(gaps_px[-1] - gaps_px[0])))
            gap_px = float(np.mean(np.hypot(*gaps_px.T)))
            least_px = rules.own_way_px + rules.own_way_share * gap_px
            n += (last - first) * (moved_px > least_px and gap_px > extent_px)
    return n


@dataclass
class _Path:
    """A piece in the making."""

    blobs: list[int]  # of successive bins
    is_mixed: bool  # two things that met are in it


def _paths(blobs: Blobs, n_bins: int, rules: ObjectRules) -> list[list[int]]:
    """Follow blobs from bin to bin; those of each path, of one a bin."""
    starts = np.searchsorted(blobs.bins, np.arange(n_bins + 1))
    going: list[_Path] = []
    done: list[_Path] = []
    for b in range(n_bins):
        here = [int(k) for k in range(starts[b], starts[b + 1]) if not blobs.at_still[k]]
        followed: list[_Path] = []
        near: dict[int, list[_Path]] = {k: [] for k in here}
        inside: dict[int, list[_Path]] = {k: [] for k in here}
        for path in going:
            step_px = _step_px(blobs.centres_px[path.blobs[-rules.velocity_bins :]])
            there_px = blobs.centres_px[path.blobs[-1]] + step_px
            reach_px = rules.reach_px + rules.reach_share * float(np.hypot(*step_px))
            box_px = blobs.corners_px[path.blobs[-1]] + np.tile(step_px, 2)
            covered = [k for k in here if _overlap(box_px, blobs.corners_px[k])]
            for k in covered:
                if _is_within(there_px, blobs.corners_px[k], rules.margin_px):
                    inside[k].append(path)
            if len(covered) > 1 or not here:  # it comes apart, or is gone
                continue
            distances_px = [float(np.hypot(*(blobs.centres_px[k] - there_px))) for k in here]
            least = int(np.argmin(distances_px))
            if distances_px[least] <= reach_px:
                near[here[least]].append(path)
        for k in here:
            met = {id(path): path for path in near[k] + inside[k]}
            mixed = len(met) > 1 or any(
                path.is_mixed and len(path.blobs) < rules.mixed_bins for path in met.values()
            )
            alone = near[k][0] if len(near[k]) == 1 else None
            if alone is not None:
                ratio = (blobs.sizes_px[k] + 1.0) / (blobs.sizes_px[alone.blobs[-1]] + 1.0)
                if mixed != alone.is_mixed or not 1.0 / rules.max_growth < ratio < rules.max_growth:
                    alone = None
            if alone is None:
                alone = _Path([], mixed)
            alone.blobs.append(k)
            followed.append(alone)
        still_going = {id(path) for path in followed}
        done += [path for path in going if id(path) not in still_going]
        going = followed
    return [
        p.blobs
        for p in sorted(done + going, key=lambda p: blobs.bins[p.blobs[0]])
        if not p.is_mixed
    ]


def _overlap(one: Array, other: Array) -> bool:
    return bool(np.all(one[:2] <= other[2:]) and np.all(other[:2] <= one[2:]))


def _is_within(point_px: Array, box_px: Array, margin_px: float) -> bool:
    low_px, high_px = box_px[:2] - margin_px, box_px[2:] + margin_px
    return bool(np.all((low_px <= point_px) & (point_px <= high_px)))


def _piece(path: list[int], blobs: Blobs, camera: Camera) -> Piece:
    chosen = np.array(path, np.int64)
    return Piece(
        int(blobs.bins[chosen[0]]),
        undistort_points(camera, blobs.centres_px[chosen]),
        blobs.n_events[chosen],
        float(np.median(blobs.sizes_px[chosen])),
        chosen,
    )


@numba.njit(cache=True)
def _labelled(
    x: Pixels, y: Pixels, bounds: IntArray, cell_px: int, still: Mask, full: int
) -> tuple[NDArray[np.int32], IntArray, Mask, IntArray]:
    """Label connected clusters of cells with events, bin by bin of time, but for still cells.

    Bounds (b, 2) are the first event of each bin and the one after its last. So many events of a
    cell hold it together with its neighbours: it is full. Gives the cluster of each event (n,), -1
    of none; the bin (k,) of each cluster, ascending, and whether it touches a still cell (k,); and
    in how many bins each cell (rows, columns) is full.
    """
    rows, columns = still.shape
    labels = np.full(len(x), -1, np.int32)
    counts, n_full = np.zeros(still.shape, np.int64), np.zeros(still.shape, np.int64)
    of_cell = np.full(still.shape, -1, np.int64)
    touched, stack = np.empty(rows * columns, np.int64), np.empty(rows * columns, np.int64)
    bins, at_still = [np.int64(0) for _ in range(0)], [False for _ in range(0)]
    for b in range(len(bounds)):
        n_touched = 0
        for i in range(bounds[b, 0], bounds[b, 1]):
            row, column = y[i] // cell_px, x[i] // cell_px
            if counts[row, column] == 0:
                touched[n_touched] = row * columns + column
                n_touched += 1
            counts[row, column] += 1
        for cell in touched[:n_touched]:
            row, column = cell // columns, cell % columns
            if counts[row, column] < full:
                continue
            n_full[row, column] += 1
            if of_cell[row, column] < 0 and not still[row, column]:
                at_still.append(_fill(row, column, len(bins), full, counts, of_cell, still, stack))
                bins.append(np.int64(b))
        for i in range(bounds[b, 0], bounds[b, 1]):
            labels[i] = of_cell[y[i] // cell_px, x[i] // cell_px]
        for cell in touched[:n_touched]:
            counts[cell // columns, cell % columns] = 0
            of_cell[cell // columns, cell % columns] = -1
    return labels, np.array(bins, np.int64), np.array(at_still, np.bool_), n_full


@numba.njit(cache=True)
def _summed(
    x: Pixels, y: Pixels, bounds: IntArray, labels: NDArray[np.int32], n_labels: int
) -> Array:
    """Sum up the events of each label (k, 9): number, x, y, x^2, y^2, least x, y, largest x, y."""
    sums = np.zeros((n_labels, 9))
    sums[:, 5:7], sums[:, 7:] = np.inf, -np.inf
    for b in range(len(bounds)):
        for i in range(bounds[b, 0], bounds[b, 1]):
            if labels[i] < 0:
                continue
            own, u, v = sums[labels[i]], float(x[i]), float(y[i])
            own[0], own[1], own[2] = own[0] + 1.0, own[1] + u, own[2] + v
            own[3], own[4] = own[3] + u * u, own[4] + v * v
            own[5], own[6] = min(own[5], u), min(own[6], v)
            own[7], own[8] = max(own[7], u), max(own[8], v)
    return sums


@numba.njit(cache=True)
def _fill(
    row: int,
    column: int,
    label: int,
    full: int,
    counts: IntArray,
    of_cell: IntArray,
    still: Mask,
    stack: IntArray,
) -> bool:
    """Label a full cell and all that hangs together with it; say if any is beside a still one."""
    rows, columns = counts.shape
    of_cell[row, column] = label
    stack[0] = row * columns + column
    n, touches = 1, False
    while n > 0:
        n -= 1
        row, column = stack[n] // columns, stack[n] % columns
        for i in range(max(row - 1, 0), min(row + 2, rows)):
            for j in range(max(column - 1, 0), min(column + 2, columns)):
                if still[i, j]:
                    touches = True
                    continue
                if counts[i, j] == 0 or of_cell[i, j] >= 0:
                    continue
                of_cell[i, j] = label
                if counts[i, j] >= full:
                    stack[n] = i * columns + j
                    n += 1
    return touches
