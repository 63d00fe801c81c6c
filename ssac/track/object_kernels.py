"""The loops over events behind the search for several objects, compiled."""

import numba
import numpy as np
from numpy.typing import NDArray

N_COLUMNS = 8
"""Of a blob: events, mean x and y, rms size, least x and y, largest x and y [px]."""

_FULL = 3  # events of a cell that hold it together with its neighbours


@numba.njit(cache=True)
def blobs_in_bins(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    bounds: NDArray[np.int64],
    cell_px: int,
    still: NDArray[np.bool_],
    least: int,
    labels: NDArray[np.int32],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    """Find connected clusters of cells with events, bin by bin of time.

    Parameters
    ----------
    x, y
        Pixels of the events, shape (n,).
    bounds
        First event of each bin and the one after its last, shape (b, 2).
    cell_px
        Side of a cell [px].
    still
        Cells (rows, columns) whose events are left out.
    least
        Events of the least cluster that is a blob.
    labels
        Filled in: the blob of each event, -1 of none; of length 0 where that is not asked for.

    Returns
    -------
    tuple
        Bin (k,) of each blob, ascending; its columns (k, N_COLUMNS); whether it touches a still
        cell (k,).
    """
    rows, columns = still.shape
    counts = np.zeros((rows, columns), np.int64)
    of_cell = np.full((rows, columns), -1, np.int64)
    touched = np.empty(rows * columns, np.int64)
    stack = np.empty(rows * columns, np.int64)
    sums = np.empty((rows * columns, N_COLUMNS + 1))
    touches = np.empty(rows * columns, np.bool_)
    index = np.empty(rows * columns, np.int64)
    bins = [np.int64(0) for _ in range(0)]
    found = [np.empty(N_COLUMNS) for _ in range(0)]
    at_still = [False for _ in range(0)]
    for b in range(len(bounds)):
        n_touched = 0
        for i in range(bounds[b, 0], bounds[b, 1]):
            row, column = y[i] // cell_px, x[i] // cell_px
            if counts[row, column] == 0:
                touched[n_touched] = row * columns + column
                n_touched += 1
            counts[row, column] += 1
        n_blobs = 0
        for k in range(n_touched):
            row, column = touched[k] // columns, touched[k] % columns
            if counts[row, column] < _FULL or of_cell[row, column] >= 0 or still[row, column]:
                continue
            touches[n_blobs] = _fill(row, column, n_blobs, counts, of_cell, still, stack)
            n_blobs += 1
        sums[:n_blobs, :5] = 0.0
        sums[:n_blobs, 5:7], sums[:n_blobs, 7:] = np.inf, -np.inf
        for i in range(bounds[b, 0], bounds[b, 1]):
            label = of_cell[y[i] // cell_px, x[i] // cell_px]
            if label < 0:
                continue
            column_px, row_px = float(x[i]), float(y[i])
            own = sums[label]
            own[0] += 1.0
            own[1] += column_px
            own[2] += row_px
            own[3] += column_px * column_px
            own[4] += row_px * row_px
            own[5], own[6] = min(own[5], column_px), min(own[6], row_px)
            own[7], own[8] = max(own[7], column_px), max(own[8], row_px)
        for label in range(n_blobs):
            own = sums[label]
            index[label] = -1
            if own[0] < least:
                continue
            index[label] = len(bins)
            mean_x, mean_y = own[1] / own[0], own[2] / own[0]
            spread = (own[3] + own[4]) / own[0] - mean_x * mean_x - mean_y * mean_y
            row_of = np.empty(N_COLUMNS)
            row_of[0], row_of[1], row_of[2] = own[0], mean_x, mean_y
            row_of[3] = np.sqrt(max(spread, 0.0))
            for c in range(4, N_COLUMNS):
                row_of[c] = own[c + 1]
            bins.append(np.int64(b))
            found.append(row_of)
            at_still.append(touches[label])
        if len(labels):
            for i in range(bounds[b, 0], bounds[b, 1]):
                label = of_cell[y[i] // cell_px, x[i] // cell_px]
                labels[i] = index[label] if label >= 0 else -1
        for k in range(n_touched):
            row, column = touched[k] // columns, touched[k] % columns
            counts[row, column] = 0
            of_cell[row, column] = -1
    table = np.empty((len(found), N_COLUMNS))
    for k in range(len(found)):
        for c in range(N_COLUMNS):
            table[k, c] = found[k][c]
    return np.array(bins, np.int64), table, np.array(at_still, np.bool_)


@numba.njit(cache=True)
def _fill(
    row: int,
    column: int,
    label: int,
    counts: NDArray[np.int64],
    of_cell: NDArray[np.int64],
    still: NDArray[np.bool_],
    stack: NDArray[np.int64],
) -> bool:
    """Label a full cell, all full ones that hang together with it, and the others beside these.

    Whether any of them lies beside a still cell.
    """
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
                if counts[i, j] >= _FULL:
                    stack[n] = i * columns + j
                    n += 1
    return touches


@numba.njit(cache=True)
def occupied_bins(
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    bounds: NDArray[np.int64],
    cell_px: int,
    rows: int,
    columns: int,
) -> NDArray[np.int64]:
    """Count the bins in which each cell (rows, columns) is full."""
    counts = np.zeros((rows, columns), np.int64)
    found = np.zeros((rows, columns), np.int64)
    for b in range(len(bounds)):
        for i in range(bounds[b, 0], bounds[b, 1]):
            row, column = y[i] // cell_px, x[i] // cell_px
            counts[row, column] += 1
            if counts[row, column] == _FULL:
                found[row, column] += 1
        for i in range(bounds[b, 0], bounds[b, 1]):
            counts[y[i] // cell_px, x[i] // cell_px] = 0
    return found
