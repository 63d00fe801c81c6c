"""Real cameras: what the method finds on public drone tracks, `ssac real`.

The data are not ours to ship, so nothing can be made again here: what the tables say of each other
is checked in its place.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import pandas as pd
import typer
from numpy.typing import NDArray

from experiments.lab.command import OutOption, check_is_folder
from experiments.lab.files import csv_text, png_bytes, record_checksums, save_text
from experiments.lab.markdown import markdown_table
from experiments.lab.provenance import provenance, write_provenance
from experiments.lab.results import Results
from experiments.lab.scored import SCORED
from experiments.lab.study import Check, How, Made, Runs, Study
from experiments.lab.verify import one_of, ordered
from experiments.worlds.tracks import (
    DATA_SETS,
    PAIR_COLUMNS,
    PATH_COLUMNS,
    ROUGHNESSES_PPM,
    STRAY_COLUMNS,
    TRIPLE_COLUMNS,
    UNKNOWN_RATES,
    VARIABLE_RATES,
    DataSet,
    Row,
    data_sets,
    pair_tables,
    path_of,
)
from ssac.cli.progress import say
from ssac.clock import PPM, Clock
from ssac.config import CLOCKS
from ssac.estimate import Status
from ssac.files.whole_file import whole_file
from ssac.fit.covariance import NORMAL_95
from ssac.network.graph import closures_s

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]
Key = tuple[int, int, int]  # data set and two cameras

PAIRS, TRIPLES, STRAYS, PATHS = "real_pairs", "real_triples", "real_strays", "real_paths"
OFFSETS_FIGURE, PATH_FIGURE = "real_offsets.png", "real_path_{}.png"
COLUMNS = {PAIRS: PAIR_COLUMNS, TRIPLES: TRIPLE_COLUMNS, STRAYS: STRAY_COLUMNS,
           PATHS: PATH_COLUMNS}  # fmt: skip
COMMAND = "make real DATA=..."
_DIGITS = 8

MVUS = {1: (0.050, 608), 2: (0.126, 793), 4: (0.535, 1572)}
"""RMSE [m] of mvus (Li et al., IROS 2020) in its published configuration, and samples of RTK, run
once and not by a command of ours; of data set 4 on the authors' automatic detections."""

WITH_TRUTH, SHIFTED = 4, 1
"""The data set with published clocks, and its camera that these put elsewhere."""

OFFSET_GIVEN = [str(status) for status in Status if status.has_offset]
_LAST_DIGIT = 1e-5  # of a closure or stray, as a share: the tables have eight digits
_KNOT_S = 1e-4  # likewise of a time
_CLOSURE_MS = 0.01  # of offsets of 100 s with eight digits, and skews with as many
_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#000000", "#777777")


def real_command(
    data: Annotated[
        Path,
        typer.Argument(
            metavar="DATA", help="Folder with dataset1 ... and calibration.", show_default=False
        ),
    ],
    out: OutOption = Path("results"),
) -> None:
    """Synchronise every pair, and solve all cameras at once, of drone-tracking's sets 1, 2 and 4.

    The data are not part of this suite: github.com/CenekAlbl/drone-tracking-datasets.
    """
    from experiments.drawing.style import comparison_png

    check_is_folder(out)
    start_s, paths, sets = time.perf_counter(), list[Row](), list[DataSet]()
    pictures = dict[str, bytes]()
    with TemporaryDirectory() as work:
        for one in data_sets(data, Path(work), say):
            sets.append(one)
            row, comparison = path_of(one)
            paths.append(row)
            pictures[PATH_FIGURE.format(one.number)] = comparison_png(comparison)
            say(
                f"{one.number}: {row['cameras']} cameras, RMSE {row['rmse_m']:.3f} m at "
                f"{row['n_rtk']} samples of RTK, {row['network_s']:.0f} s"
            )
    tables = {**pair_tables(sets), PATHS: pd.DataFrame(paths, columns=PATH_COLUMNS)}
    pictures[OFFSETS_FIGURE] = png_bytes(real_figure(tables[PAIRS], tables[STRAYS]))
    content = provenance(COMMAND, config(), time.perf_counter() - start_s, None)
    for name, table in tables.items():
        save_text(out / f"{name}.csv", csv_text(table, _DIGITS))
        write_provenance(out / f"{name}.csv", content)
    for file, picture in pictures.items():
        with whole_file(out / file) as temporary:
            temporary.write_bytes(picture)
    record_checksums(out, [out / file for file in STUDIES[0].files])
    statuses = tables[PAIRS]["status"]
    answered = statuses.isin(OFFSET_GIVEN).sum()
    typer.echo(f"{answered} of {len(statuses)} pairs answered; {out / PAIRS}.csv")


def config() -> dict[str, Any]:
    """Give what all pairs are made with, for provenance."""
    rates = {f"data set {number}, camera {k}": rate for (number, k), rate in UNKNOWN_RATES.items()}
    variable = [f"data set {number}, camera {k}" for number, k in sorted(VARIABLE_RATES)]
    return {
        "data_sets": DATA_SETS,
        "rates": rates,
        "variable_rates": {"cameras": variable, "roughnesses_ppm": ROUGHNESSES_PPM},
    }


def real_figure(pairs: pd.DataFrame, strays: pd.DataFrame) -> "Figure":
    """Draw how far readouts move the offsets, and how far the clocks of frames wander."""
    from matplotlib.figure import Figure

    from experiments.drawing.style import WIDTH_IN, quiet_axes

    figure = Figure(figsize=(WIDTH_IN, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for axes in (left, right):
        quiet_axes(axes)
    _draw_readouts(left, pairs[pairs["by_readouts_ms"].notna()])
    _draw_strays(right, strays)
    return figure


def _draw_readouts(axes: "Axes", pairs: pd.DataFrame) -> None:
    places = np.arange(len(pairs))
    moved_ms = pairs["by_readouts_ms"].to_numpy()
    for shift, offset_ms, column, label in (
        (-0.15, 0.0 * moved_ms, "global_std_ms", "shutters taken for global ones"),
        (0.15, moved_ms, "t_d_std_ms", "readouts estimated"),
    ):
        error_ms = NORMAL_95 * pairs[column].to_numpy()
        color = _COLORS[int(shift < 0.0)]
        axes.errorbar(
            places + shift, offset_ms, error_ms, fmt="o", ms=3, lw=1.0, color=color, label=label
        )
    names = [f"{one.data_set}: {one.camera_1}-{one.camera_2}" for one in pairs.itertuples()]
    axes.set_xticks(places, names, rotation=90, fontsize=6)
    axes.set_ylabel("offset, moved by readouts [ms]")
    axes.legend(fontsize=7, frameon=False)


def _draw_strays(axes: "Axes", strays: pd.DataFrame) -> None:
    for k, (name, knots) in enumerate(strays.groupby(["data_set", "camera_1", "camera_2"])):
        number, one, other = name
        color, style = _COLORS[k % len(_COLORS)], ("-", "--")[k // len(_COLORS) % 2]
        axes.plot(
            knots["t_s"], knots["stray_ms"], color=color, ls=style, lw=1.0,
            label=f"{number}: {one}-{other}",
        )  # fmt: skip
    axes.set(
        xlabel="time of the first camera's clock [s]", ylabel="stray from an affine clock [ms]"
    )
    if len(strays):
        axes.legend(fontsize=6, frameon=False, ncols=2)


# --- What the tables must say of themselves and of each other ---


def _columns(results: Results) -> Iterator[str]:
    for name, columns in COLUMNS.items():
        there = [str(one) for one in results.table(name)]
        if there != list(columns):
            yield f"{name}.csv has the columns {', '.join(there)}; expected {', '.join(columns)}"


def _pair_faults(results: Results) -> Iterator[str]:
    pairs = results.table(PAIRS)
    rows: dict[Key, Any] = {_key(row): row for row in pairs.to_dict("records")}
    if len(rows) < len(pairs):
        yield "a pair is there twice"
    expected = [
        (number, *two)
        for number in DATA_SETS
        for two in combinations(
            range(max((k[2] for k in rows if k[0] == number), default=1) + 1), 2
        )
    ]
    if list(rows) != expected:
        yield "its rows are not all pairs of cameras of each data set, in order"
    for (number, i, j), row in rows.items():
        name = f"data set {number}, cameras {i} {j}"
        if row["status"] in OFFSET_GIVEN:
            yield from (
                f"{name}: {column} is {row[column]}"
                for column in ("t_d_s", "t_ref_s", "residual_px")
                if not np.isfinite(row[column])
            )
        elif not isinstance(row["reason"], str):
            yield f"{name}: {row['status']}, and it does not say why"


def _triple_faults(results: Results) -> Iterator[str]:
    pairs = results.table(PAIRS).to_dict("records")
    answered = {_key(row) for row in pairs if row["status"] in OFFSET_GIVEN}
    closures_ms: dict[Key, float] = {}
    found: list[tuple[int, ...]] = []
    for row in results.table(TRIPLES).to_dict("records"):
        number, cameras = int(row["data_set"]), tuple(map(int, row["cameras"].split("-")))
        found.append((number, *cameras))
        for i, j in combinations(cameras, 2):
            most_ms = max(closures_ms.get((number, i, j), 0.0), abs(row["closure_ms"]))
            closures_ms[number, i, j] = most_ms
    n_cameras = 1 + max((j for _, _, j in answered), default=0)
    expected = [
        (number, *three)
        for number in DATA_SETS
        for three in combinations(range(n_cameras), 3)
        if all((number, *two) in answered for two in combinations(three, 2))
    ]
    if found != expected:
        yield "not each triple of which all pairs are answered is there once"
    for number in DATA_SETS:
        clocks = {
            _key(row)[1:]: Clock(row["t_d_s"], np.nan_to_num(row["skew_ppm"]), row["t_ref_s"])
            for row in pairs
            if row["data_set"] == number and _key(row) in answered and row["clock"] == "affine"
        }
        of_set = results.table(TRIPLES).set_index(["data_set", "cameras"])["closure_ms"]
        for triple, closure_s in closures_s(clocks).items():
            there_ms = of_set.get((number, "-".join(map(str, triple))), np.nan)
            if not abs(1e3 * closure_s - there_ms) <= _CLOSURE_MS:
                yield f"data set {number}, {triple}: closes to {there_ms} ms, not as its pairs do"
    yield from _unlike(pairs, "closure_ms", closures_ms, np.nan)


def _stray_faults(results: Results) -> Iterator[str]:
    strays = results.table(STRAYS)
    most_ms: dict[Key, float] = {}
    for row in strays.to_dict("records"):
        most_ms[_key(row)] = max(most_ms.get(_key(row), 0.0), abs(row["stray_ms"]))
    pairs = results.table(PAIRS).to_dict("records")
    yield from _unlike(pairs, "most_stray_ms", most_ms, 0.0)
    none = set(most_ms) - {_key(row) for row in pairs}
    if none:
        yield f"it has pairs that are none: {', '.join(map(str, sorted(none)))}"
    for _, knots in strays.groupby(["data_set", "camera_1", "camera_2"]):
        key = _key(knots.iloc[0].to_dict())
        times_s, strays_ms = knots["t_s"].to_numpy(), knots["stray_ms"].to_numpy()
        if len(knots) < 2 or np.ptp(np.diff(times_s)) > _KNOT_S:
            yield f"the knots of {key} are not several, evenly spaced"
            continue
        # What strays is the rest beside the best affine clock: it has no mean and no slope.
        lever_s = times_s - times_s.mean()
        off_ms = max(abs(strays_ms.sum()), abs(lever_s @ strays_ms) / np.abs(lever_s).max())
        if off_ms > _LAST_DIGIT * np.abs(strays_ms).sum():
            yield f"the strays of {key} are not beside an affine clock"


def _unlike(
    pairs: Sequence[Mapping[Any, Any]], column: str, others: dict[Key, float], default: float
) -> Iterator[str]:
    """Compare a column of the pairs with what another table gives for it."""
    for row in pairs:
        value, other = row[column], others.get(_key(row), default)
        if not np.isclose(value, other, rtol=_LAST_DIGIT, atol=1e-6, equal_nan=True):
            yield f"{_key(row)}: {column} is {value} in the pairs, {other} here"


def _path_faults(results: Results) -> Iterator[str]:
    paths = results.table(PATHS)
    if list(paths["data_set"]) != list(DATA_SETS):
        yield f"{PATHS}.csv has not each data set once"
    if not paths["coverage"].between(0.0, 1.0).all():
        yield "a coverage is no share"


def _key(row: Mapping[Any, Any]) -> Key:
    return int(row["data_set"]), int(row["camera_1"]), int(row["camera_2"])


def _check(what: str, faults: Callable[[Results], Iterator[str]]) -> Check:
    return what, lambda results: tuple(faults(results))


# --- What pages quote ---


def largest_closure(results: Results, number: int) -> str:
    """Say by how much the clocks of three cameras contradict each other at most."""
    closures_ms = _closures_ms(results, number)
    return f"{np.abs(closures_ms).max():.0f} ms" if len(closures_ms) else "none"


def largest_difference(results: Results, with_shifted: bool) -> str:
    """Say how far pairs of constant rate are off the published clocks, with that camera or not."""
    rows = _constant(results)
    if not with_shifted:
        rows = rows[(rows["camera_1"] != SHIFTED) & (rows["camera_2"] != SHIFTED)]
    return f"{np.abs(rows['from_truth_ms']).max():.0f} ms"


def apart(results: Results) -> str:
    """Say how far one camera's clock is off the published, where the others are so on average.

    By least squares each camera is off by an amount of its own, and a pair by their difference.
    """
    rows = _constant(results)
    cameras = sorted({*rows["camera_1"], *rows["camera_2"]})
    by = np.zeros((len(rows), len(cameras)))
    for n, (i, j) in enumerate(zip(rows["camera_1"], rows["camera_2"], strict=True)):
        by[n, cameras.index(i)], by[n, cameras.index(j)] = -1.0, 1.0
    off_ms = np.linalg.lstsq(by, rows["from_truth_ms"].to_numpy(), rcond=None)[0]
    at = cameras.index(SHIFTED)
    return f"{off_ms[at] - np.mean(np.delete(off_ms, at)):.0f} ms"


def readouts_of(results: Results, camera: int) -> str:
    """Range of the readouts that the pairs of a camera found, with the largest deviation."""
    rows = results.rows(PAIRS, data_set=WITH_TRUTH)
    found = [
        rows[rows[f"camera_{k}"] == camera][[f"readout_{k}_ms", f"readout_{k}_std_ms"]].to_numpy()
        for k in (1, 2)
    ]
    values_ms, stds_ms = np.vstack(found).T
    return (
        f"{np.nanmin(values_ms):.0f} to {np.nanmax(values_ms):.0f} ms (1 sigma up to "
        f"{np.nanmax(stds_ms):.0f} ms)"
    )


def moved_by_readouts(results: Results) -> str:
    """Say how far readouts move an offset at most."""
    return f"{np.nanmax(np.abs(results.column(PAIRS, 'by_readouts_ms'))):.0f} ms"


def rate(results: Results, camera: int) -> str:
    """Rate of a camera's clock by that of camera 0, which counts frames at a constant rate."""
    of = {"data_set": WITH_TRUTH, "camera_1": 0, "camera_2": camera}
    return f"{1.0 + PPM * results.value(PAIRS, 'skew_ppm', **of):.4f}"


def strays_range(results: Results) -> str:
    """Range of how far clocks of cameras of varying rates stray, of all their pairs."""
    rows = results.rows(PAIRS, data_set=WITH_TRUTH)
    rows = rows[_varies(rows) & rows["status"].isin(OFFSET_GIVEN)]
    return f"{rows['most_stray_ms'].min():.0f} to {rows['most_stray_ms'].max():.0f} ms"


def pairs_table(results: Results) -> str:
    """Lay out, by data set, how many pairs are answered, how they agree, and how long it took."""
    body = []
    for number in DATA_SETS:
        rows = results.rows(PAIRS, data_set=number)
        tried = np.array([any((number, k) in UNKNOWN_RATES for k in pair) for pair in _pairs(rows)])
        seconds = rows["seconds"].to_numpy()
        n_triples = len(_closures_ms(results, number))
        body.append(
            [
                str(number),
                f"{int(rows['status'].isin(OFFSET_GIVEN).sum())} of {len(rows)}",
                f"{n_triples}, {largest_closure(results, number)}",
                f"{np.median(rows['t_d_std_ms']):.1f} ms",
                f"{seconds[~tried].max():.0f} s",
                f"{seconds[tried].max():.0f} s" if tried.any() else "",
            ]
        )
    header = ["data set", "pairs answered", "triples, most open"]
    header += ["median deviation", "longest pair", "with a search of rates"]
    return markdown_table(header, body)


def paths_table(results: Results) -> str:
    """Lay out how each path lies beside RTK, mvus' beside it."""
    body = []
    for row in results.table(PATHS).to_dict("records"):
        rmse_m, n_rtk = MVUS[int(row["data_set"])]
        off_ms = float(row["most_from_truth_ms"])
        body.append(
            [
                f"{row['data_set']:.0f}",
                f"{row['cameras']:.0f}",
                f"{row['rmse_m']:.3f} / {row['median_m']:.3f} / {row['max_m']:.2f} m",
                f"{row['n_rtk']:.0f}",
                f"{100 * row['coverage']:.0f} %",
                f"{off_ms:.0f} ms" if np.isfinite(off_ms) else "",
                f"{row['rms_px']:.2f} px",
                f"{row['pairs_s']:.0f} + {row['network_s']:.0f} s",
                f"{rmse_m:.3f} m, {n_rtk}",
            ]
        )
    header = ["set", "cameras", "RMSE / median / most", "RTK", "seen", "clocks off", "residual"]
    header += ["time", "mvus: RMSE, RTK"]
    return markdown_table(header, body)


def _closures_ms(results: Results, number: int) -> FloatArray:
    """Give the closures (k,) of a data set's triples, of which there may be none."""
    table = results.table(TRIPLES)
    return table["closure_ms"][table["data_set"] == number].to_numpy(np.float64)


def _constant(results: Results) -> pd.DataFrame:
    """Give the answered pairs with published clocks of which both cameras' rates are constant."""
    rows = results.rows(PAIRS, data_set=WITH_TRUTH)
    given = rows["status"].isin(OFFSET_GIVEN) & rows["from_truth_ms"].notna()
    return rows[~_varies(rows) & given]


def _varies(rows: pd.DataFrame) -> "pd.Series[bool]":
    found = [any((WITH_TRUTH, k) in VARIABLE_RATES for k in pair) for pair in _pairs(rows)]
    return pd.Series(found, index=rows.index)


def _pairs(rows: pd.DataFrame) -> list[tuple[int, int]]:
    return list(zip(rows["camera_1"], rows["camera_2"], strict=True))


STUDIES = (
    Study(
        "real",
        "Public drone-tracking data sets",
        lambda: (),
        SCORED,
        Runs(f"{PAIRS}.csv", PAIR_COLUMNS[:3], numbered=False, digits=_DIGITS),
        tuple(
            Made(file, None, _DIGITS)
            for file in (
                *(f"{name}.csv" for name in (TRIPLES, STRAYS, PATHS)),
                OFFSETS_FIGURE,
                *(PATH_FIGURE.format(number) for number in DATA_SETS),
            )
        ),
        numbers={
            "real.closure.4": partial(largest_closure, number=WITH_TRUTH),
            "real.off": partial(largest_difference, with_shifted=True),
            "real.off.others": partial(largest_difference, with_shifted=False),
            "real.camera1.apart": apart,
            "real.camera1.readouts": partial(readouts_of, camera=SHIFTED),
            "real.camera1.rate": partial(rate, camera=SHIFTED),
            "real.camera3.rate": partial(rate, camera=3),
            "real.readouts": moved_by_readouts,
            "real.strays": strays_range,
            "table.real.pairs": pairs_table,
            "table.real.paths": paths_table,
        },
        checks=(
            _check("the tables have their columns", _columns),
            ("statuses are those of estimates", one_of(PAIRS, "status", *map(str, Status))),
            ("clocks are models of ours", one_of(PAIRS, "clock", *CLOCKS)),
            _check("each pair is there once, with an offset or a reason", _pair_faults),
            _check("triples are of answered pairs and close as these say", _triple_faults),
            _check("knots are of pairs and stray as these say", _stray_faults),
            _check("each data set has a path", _path_faults),
            ("a mean is at most an RMSE", ordered(PATHS, "mean_m", "rmse_m")),
            ("an RMSE is at most a maximum", ordered(PATHS, "rmse_m", "max_m")),
        ),
        config=config(),
        command=COMMAND,
        how=How.GIVEN,
    ),
)
