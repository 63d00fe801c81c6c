"""Find the objects that move before one camera, and follow each as far as possible.

Ordinary recordings show one object, as a few short bins of time tell. Where there are several, the
events of each bin are grouped into blobs of connected cells. Blobs are followed from bin to bin as
pieces of paths, which end where two blobs meet or one splits. Cells of things that stay in place,
such as a branch in the wind, are left out.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import binary_dilation, label, minimum_filter

from ssac.arrays import Array, Events, Int32Array, IntArray, Mask
from ssac.camera import Camera, undistort_points
from ssac.events import first_from
from ssac.rules import ObjectRules


@dataclass(frozen=True)
class Blobs:
    """Clusters of events, bin by bin."""

    bins: IntArray  # (k,) ascending
    n_events: Array  # (k,)
    centres_px: Array  # (k, 2) in raw pixels
    sizes_px: Array  # (k,) rms
    corners_px: Array  # (k, 4) least x and y, largest x and y
    at_still: Mask  # (k,) beside something that stays in its place


@dataclass(frozen=True)
class Piece:
    """An object's path for as long as it is alone."""

    first: int  # bin, counted from the recording's start
    positions_px: Array  # (n, 2) undistorted, one for each bin
    n_events: Array  # (n,)
    size_px: float  # median rms size of the image
    blobs: IntArray  # (n,) index of its blob in each bin

    @property
    def last(self) -> int:
        """Bin after the last one of the piece."""
        return self.first + len(self.positions_px)


@dataclass(frozen=True)
class Objects:
    """The objects that move before one camera."""

    start_us: int  # of the first bin
    bin_us: int  # length of a bin
    are_several: bool  # several objects, not parts of one, which stay together
    n_seen: int  # objects at a time, including those that stay in place
    pieces: list[Piece]  # of objects that move, in order of time
    blob_of_event: Int32Array = field(repr=False)  # (n,); -1: of none

    def events_of(self, pieces: list[Piece]) -> Mask:
        """Tell which events (n,) belong to any of these pieces."""
        return np.isin(self.blob_of_event, [k for piece in pieces for k in piece.blobs])


def seem_several(events: Events, camera: Camera, rules: ObjectRules) -> bool:
    """Whether more than one object is seen at a time, judged by some of the bins."""
    if len(events) == 0:
        return False
    cell_px, still = _cells(camera, rules)
    bounds = _bounds(events, rules.bin_us, rules.look_every)
    events = np.concatenate([events[first:last] for first, last in bounds])
    counts = np.diff(bounds).ravel()
    ends = np.cumsum(counts)
    bounds = np.column_stack([ends - counts, ends])
    blobs, *_ = _blobs(events, bounds, cell_px, still, rules)
    n_things = _things(blobs, len(bounds), cell_px, rules)
    return bool(np.mean(n_things > 1) > rules.several_share)


def objects_of(events: Events, camera: Camera, rules: ObjectRules) -> Objects:
    """Follow all moving objects in a camera's denoised events (n,), sorted by time."""
    (cell_px, still), bounds = _cells(camera, rules), _bounds(events, rules.bin_us)
    blobs, _, n_full = _blobs(events, bounds, cell_px, still, rules)
    n_things = _things(blobs, len(bounds), cell_px, rules)
    n_seen = int(np.quantile(n_things, 1.0 - rules.several_share))
    still = n_full > rules.still_share * len(bounds)
    share_still = float(np.mean(still[events["y"] // cell_px, events["x"] // cell_px]))
    blobs, labels, _ = _blobs(events, bounds, cell_px, still, rules)
    paths = [path for path in _paths(blobs, len(bounds), rules) if len(path) >= rules.least_bins]
    extent_px = _extent_px(blobs, len(bounds))
    is_part = _are_parts(blobs, extent_px)
    pieces = [_piece(path, blobs, camera) for path in paths if np.mean(is_part[path]) < 0.5]
    share_apart = _bins_of_their_own_way(pieces, extent_px, rules) / len(bounds)
    # A large object also fills cells for long, but its blobs split at ever other places.
    longest = max((len(piece.positions_px) for piece in pieces), default=0)
    has_still = share_still > rules.several_share and longest >= rules.lasting_bins
    are_several = has_still or share_apart > 0.5 * rules.several_share
    return Objects(int(events["t"][0]), rules.bin_us, are_several, n_seen, pieces, labels)


def _cells(camera: Camera, rules: ObjectRules) -> tuple[int, Mask]:
    """Cut a sensor into square cells: their side, and the mask (rows, columns) of still ones."""
    cell_px = max(1, round(rules.cell_widths * camera.width))
    shape = -(-camera.height // cell_px), -(-camera.width // cell_px)
    return cell_px, np.zeros(shape, np.bool_)


def _bounds(events: Events, bin_us: int, every: int = 1) -> IntArray:
    """Return the indices (b, 2) of the first events in each `every`-th bin and after its end."""
    times_us = events["t"]
    n_bins = int(times_us[-1] - times_us[0]) // bin_us + 1
    starts = np.arange(0, n_bins, every, dtype=np.int64)
    ends_us = times_us[0] + np.stack([starts, starts + 1], axis=1) * bin_us
    return first_from(times_us, ends_us.ravel()).reshape(ends_us.shape).astype(np.int64)


def _blobs(
    events: Events, bounds: IntArray, cell_px: int, still: Mask, rules: ObjectRules
) -> tuple[Blobs, Int32Array, IntArray]:
    """Find blobs, the blob of each event (n,), -1: none, and in how many bins each cell is full."""
    full = rules.full_cell_events
    labels, bins, at_still, n_full = _labelled(events, bounds, cell_px, still, full)
    counts = np.bincount(labels + 1, minlength=len(bins) + 1)[1:]
    kept = counts >= rules.least_blob_events
    bins, at_still, n = bins[kept], at_still[kept], counts[kept].astype(np.float64)
    labels = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1).astype(np.int32)[labels]
    own = labels >= 0
    k, u, v = labels[own], *(events[axis][own].astype(np.float64) for axis in "xy")
    x, y, squares = (np.bincount(k, term, len(n)) / n for term in (u, v, u**2 + v**2))
    sizes = np.sqrt(np.maximum(squares - x**2 - y**2, 0.0))
    corners = np.repeat([[np.inf, np.inf, -np.inf, -np.inf]], len(n), axis=0)
    for column, places in enumerate((u, v)):
        np.minimum.at(corners[:, column], k, places)
        np.maximum.at(corners[:, 2 + column], k, places)
    return Blobs(bins, n, np.column_stack([x, y]), sizes, corners, at_still), labels, n_full


def _labelled(
    events: Events, bounds: IntArray, cell_px: int, still: Mask, full: int
) -> tuple[Int32Array, IntArray, Mask, IntArray]:
    """Label the connected clusters of full cells in each bin of time, leaving out still cells."""
    # A cell with `full` events or more is full, and joins its full neighbours. Returned are the
    # cluster of each event (n,), -1 of none; the bin (k,) of each cluster, ascending, and whether
    # it touches a still cell (k,); and in how many bins each cell (rows, columns) is full.
    beside = np.ones((3, 3), np.bool_)
    at_still = binary_dilation(still, beside)
    cell_of_event = (events["y"] // cell_px) * np.intp(still.shape[1])
    cell_of_event += events["x"] // cell_px
    labels, n_full = np.full(len(events), -1, np.int32), np.zeros(still.shape, np.int64)
    bins: list[int] = []
    touch: list[bool] = []
    for b, (first, last) in enumerate(bounds):
        own = cell_of_event[first:last]
        is_full = np.bincount(own, minlength=still.size).reshape(still.shape) >= full
        n_full += is_full
        is_full &= ~still
        found = np.zeros(still.shape, np.int32)
        label(is_full, beside, output=found)
        n = int(found.max())
        # Clusters are numbered by their first events; the first also takes the cells beside it.
        of_events = found.flat[own]
        _, firsts = np.unique(of_events[of_events > 0], return_index=True)
        order = np.append(n, np.argsort(np.argsort(firsts)))[found]
        nearest = minimum_filter(order, 3, mode="constant", cval=n)
        nearest[still | (nearest == n)] = -1 - len(bins)
        labels[first:last] = nearest.flat[own] + len(bins)
        touch += (np.bincount(order[is_full], at_still[is_full], minlength=n) > 0).tolist()
        bins += [b] * n
    return labels, np.array(bins, np.int64), np.array(touch, np.bool_), n_full


def _things(blobs: Blobs, n_bins: int, cell_px: int, rules: ObjectRules) -> IntArray:
    """Count the objects (b,) in each bin: blobs well apart, taken from the largest on."""
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
    """Whether the gap between two boxes is large compared with the larger of them."""
    gap_px = float(np.max([one[:2] - other[2:], other[:2] - one[2:]]))
    larger_px = max(np.hypot(*(one[2:] - one[:2])), np.hypot(*(other[2:] - other[:2])))
    return bool(gap_px > max(rules.apart_cells * cell_px, rules.apart_sizes * larger_px))


def _extent_px(blobs: Blobs, n_bins: int) -> float:
    """Median [px] over the bins of the longest diagonal of a blob."""
    longest_px = np.zeros(n_bins)
    diagonals_px = np.hypot(*(blobs.corners_px[:, 2:] - blobs.corners_px[:, :2]).T)
    np.maximum.at(longest_px, blobs.bins, diagonals_px)
    return float(np.median(longest_px[longest_px > 0.0])) if longest_px.any() else 0.0


def _are_parts(blobs: Blobs, extent_px: float) -> Mask:
    """Tell which blobs (k,) have one of more events in the bin nearer than an object's extent."""
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


@dataclass(eq=False)
class _Path:
    """A piece that is still being followed."""

    blobs: list[int]  # of successive bins
    is_mixed: bool  # it holds two objects that met


def _paths(blobs: Blobs, n_bins: int, rules: ObjectRules) -> list[list[int]]:
    """Follow blobs from bin to bin; return the blobs, one per bin, of each path of one object."""
    starts = np.searchsorted(blobs.bins, np.arange(n_bins + 1))
    going: list[_Path] = []
    done: list[_Path] = []
    for b in range(n_bins):
        here = [int(k) for k in range(starts[b], starts[b + 1]) if not blobs.at_still[k]]
        followed: list[_Path] = []
        near: dict[int, list[_Path]] = {k: [] for k in here}
        inside: dict[int, list[_Path]] = {k: [] for k in here}
        for path in going:
            some_px = blobs.centres_px[path.blobs[-rules.velocity_bins :]]
            step_px = (some_px[-1] - some_px[0]) / max(len(some_px) - 1, 1)
            there_px = blobs.centres_px[path.blobs[-1]] + step_px
            reach_px = rules.reach_px + rules.reach_share * float(np.hypot(*step_px))
            box_px = blobs.corners_px[path.blobs[-1]] + np.tile(step_px, 2)
            covered = [k for k in here if _overlap(box_px, blobs.corners_px[k])]
            for k in covered:
                if _overlap(np.tile(there_px, 2), blobs.corners_px[k], rules.margin_px):
                    inside[k].append(path)
            if len(covered) > 1 or not here:  # it splits, or is gone
                continue
            distances_px = [float(np.hypot(*(blobs.centres_px[k] - there_px))) for k in here]
            least = int(np.argmin(distances_px))
            if distances_px[least] <= reach_px:
                near[here[least]].append(path)
        for k in here:
            met = {*near[k], *inside[k]}
            mixed = len(met) > 1 or any(
                path.is_mixed and len(path.blobs) < rules.mixed_bins for path in met
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
        done += [path for path in going if path not in followed]
        going = followed
    paths = sorted(done + going, key=lambda path: blobs.bins[path.blobs[0]])
    return [path.blobs for path in paths if not path.is_mixed]


def _overlap(one: Array, other: Array, margin_px: float = 0.0) -> bool:
    """Whether two boxes (4,) overlap, the second widened by a margin."""
    low, high = other[:2] - margin_px, other[2:] + margin_px
    return bool(np.all(one[:2] <= high) and np.all(low <= one[2:]))


def _piece(path: list[int], blobs: Blobs, camera: Camera) -> Piece:
    chosen = np.array(path, np.int64)
    return Piece(
        int(blobs.bins[chosen[0]]),
        undistort_points(camera, blobs.centres_px[chosen]),
        blobs.n_events[chosen],
        float(np.median(blobs.sizes_px[chosen])),
        chosen,
    )
