"""Real cameras: what the method finds on public drone tracks, `ssac real`.

The data are not ours to ship, so the tables cannot be reproduced here; the checks compare them with
each other instead.
"""

import time
from collections.abc import Container, Iterator, Mapping
from functools import partial
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer
from numpy.typing import NDArray

from experiments.drawing.style import ACCENT, Axes, Figure, panels, quiet_axes
from experiments.lab.command import OutOption
from experiments.lab.provenance import provenance, provenance_file
from experiments.lab.results import File, Results, csv_text, png_bytes, save_files
from experiments.lab.scored import SCORED
from experiments.lab.study import How, Made, Runs, Study
from experiments.lab.summary import markdown_table, quoted_of, shown_table
from experiments.lab.verify import no_row
from experiments.worlds import tracks
from experiments.worlds.tracks import DATA_SETS, KEY, UNKNOWN_RATES, VARIABLE_RATES
from ssac.arrays import Array
from ssac.cli.progress import say
from ssac.clock import PPM, Clock
from ssac.config import CLOCKS
from ssac.errors import SsacError
from ssac.estimate import Status
from ssac.fit.covariance import NORMAL_95
from ssac.network.graph import closures_s

Key = tuple[int, int, int]  # data set and two cameras

PAIRS, TRIPLES, STRAYS, PATHS = "real_pairs", "real_triples", "real_strays", "real_paths"
OFFSETS_FIGURE, PATH_FIGURE = "real_offsets.png", "real_path_{}.png"
COMMAND = "make real DATA=..."
_DIGITS = 8

MVUS = {1: (0.050, 608), 2: (0.126, 793), 4: (0.535, 1572)}
"""RMSE [m] of mvus (Li et al., IROS 2020) in its published configuration, and samples of RTK, run
once and not by a command of ours; of data set 4 on the authors' automatic detections."""

WITH_TRUTH, SHIFTED = 4, 1
"""The data set with published clocks, and its camera whose published clock disagrees with ours."""

OFFSET_GIVEN = [str(status) for status in Status if status.has_offset]
_LAST_DIGIT = 1e-5  # relative tolerance of closures and strays: tables have eight digits
_AFFINE_MS = 1e-5  # tolerance of strays beside an affine clock
_KNOT_S = 1e-4  # tolerance of the times between knots
_CLOSURE_MS = 0.01  # tolerance of closures: offsets of 100 s and skews have eight digits
_COLUMNS = 5  # of small axes, one for each pair


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
    from ssac.pipeline.plots import draw_comparison

    if not out.is_dir():
        raise SsacError(f"{out}: there is no such folder: make it, or name another")
    start_s, paths, sets = time.perf_counter(), list[tracks.Row](), list[tracks.DataSet]()
    pictures = dict[str, bytes]()
    with TemporaryDirectory() as work:
        for one in tracks.data_sets(data, Path(work), say):
            sets.append(one)
            row, comparison = tracks.path_of(one)
            paths.append(row)
            drawn = draw_comparison(comparison)
            drawn.suptitle(f"Public data set {one.number}: the path found, and RTK")
            pictures[PATH_FIGURE.format(one.number)] = png_bytes(drawn)
            say(
                f"{one.number}: {row['cameras']} cameras, RMSE {row['rmse_m']:.3f} m at "
                f"{row['n_rtk']} samples of RTK, {row['network_s']:.0f} s"
            )
    tables = {**tracks.pair_tables(sets), PATHS: pd.DataFrame(paths)}
    content = provenance(COMMAND, config(), time.perf_counter() - start_s, None)

    def files() -> Iterator[File]:
        for name, table in tables.items():
            yield f"{name}.csv", csv_text(table, _DIGITS).encode()
            yield provenance_file(name, content)
        yield from pictures.items()
        yield OFFSETS_FIGURE, png_bytes(real_figure(Results(out)))

    save_files(out, files())
    statuses = tables[PAIRS]["status"]
    answered = statuses.isin(OFFSET_GIVEN).sum()
    typer.echo(f"{answered} of {len(statuses)} pairs answered; {out / PAIRS}.csv")


def config() -> dict[str, Any]:
    """Return the configuration of all pairs, for provenance."""
    rates = {f"data set {number}, camera {k}": rate for (number, k), rate in UNKNOWN_RATES.items()}
    variable = [f"data set {number}, camera {k}" for number, k in sorted(VARIABLE_RATES)]
    roughnesses = {"cameras": variable, "roughnesses_ppm": tracks.ROUGHNESSES_PPM}
    return {"data_sets": DATA_SETS, "rates": rates, "variable_rates": roughnesses}


def real_figure(results: Results) -> Figure:
    """Draw how far readouts move the offsets, and how far clocks stray from affine ones."""
    pairs, title = results.table(PAIRS), "Public videos: what shutters and clocks do to the offsets"
    strays = dict(list(results.table(STRAYS).groupby(KEY)))
    rows = 1 + max(1, -(-len(strays) // _COLUMNS))
    shared = {"sharex": True, "sharey": True, "height_ratios": [2.4] + [1.0] * (rows - 1)}
    figure, (first, *below) = panels(title, 4.2 + 1.2 * (rows - 1), rows, _COLUMNS, **shared)
    for axes in first:
        axes.remove()
    above = figure.add_subplot(first[0].get_gridspec()[0, :])
    quiet_axes(above)
    _draw_readouts(above, pairs[pairs["by_readouts_ms"].notna()])
    _draw_strays(np.ravel(below), strays)
    return figure


def _draw_readouts(axes: Axes, pairs: pd.DataFrame) -> None:
    places = np.arange(len(pairs))
    moved_ms = pairs["by_readouts_ms"].to_numpy()
    for shift, offset_ms, column, color, label in (
        (-0.15, 0.0 * moved_ms, "global_std_ms", "0.6", "shutters taken for global ones"),
        (0.15, moved_ms, "t_d_std_ms", ACCENT, "readouts estimated"),
    ):
        axes.errorbar(
            places + shift, offset_ms, NORMAL_95 * pairs[column].to_numpy(), fmt="o", ms=3, lw=1.0,
            color=color, label=label,
        )  # fmt: skip
    names = [f"{one.data_set}: {one.camera_1}-{one.camera_2}" for one in pairs.itertuples()]
    axes.set_xticks(places, names, rotation=90, fontsize=7)
    axes.set_xlabel("data set: pair of cameras; a bar is the interval of 95 %")
    axes.set_ylabel("offset, moved by readouts [ms]")
    axes.legend(fontsize=8, frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def _draw_strays(panels_of: NDArray[Any], strays: Mapping[Any, pd.DataFrame]) -> None:
    """Draw the stray from an affine clock of each pair in axes of its own, the others' in grey."""
    figure = panels_of[0].figure
    for axes in panels_of[len(strays) :]:
        axes.set_axis_off()
    for axes, ((number, one, other), knots) in zip(panels_of, strays.items(), strict=False):
        for others in strays.values():
            axes.plot(others["t_s"], others["stray_ms"], color="0.88", lw=0.6)
        axes.plot(knots["t_s"], knots["stray_ms"], color=ACCENT, lw=1.2)
        axes.set_title(f"{number}: {one}-{other}", fontsize=8)
    figure.supxlabel("time of the first camera's clock [s]", fontsize=10)
    panels_of[0].set_ylabel("stray from an\naffine clock [ms]")


# --- What the tables must say of themselves and of each other ---


def _keys(rows: pd.DataFrame) -> list[Key]:
    return list(rows[KEY].itertuples(index=False, name=None))


def _pair_faults(results: Results) -> Iterator[str]:
    pairs = results.table(PAIRS)
    n_cameras = 1 + pairs.groupby("data_set")["camera_2"].max()
    expected = [(i, *two) for i, n in n_cameras.items() for two in combinations(range(n), 2)]
    if list(n_cameras.index) != list(DATA_SETS) or _keys(pairs) != expected:
        yield "its rows are not all pairs of cameras of each data set, in order"
    given = pairs["status"].isin(OFFSET_GIVEN)
    for column in ("t_d_s", "t_ref_s", "residual_px"):
        unknown = pairs[given & ~np.isfinite(pairs[column])]
        yield from (f"{key} is answered without {column}" for key in _keys(unknown))


def _triple_faults(results: Results) -> Iterator[str]:
    pairs, triples, most_ms = results.table(PAIRS), results.table(TRIPLES), dict[Key, float]()
    given = pairs[pairs["status"].isin(OFFSET_GIVEN)].fillna({"skew_ppm": 0.0})
    affine = {*_keys(given[given["clock"] == "affine"])}
    expected = dict[tuple[Any, ...], float]()
    for number, of_set in given.groupby("data_set"):
        numbers = of_set[["t_d_s", "skew_ppm", "t_ref_s"]].to_numpy()
        of_pairs = zip(_keys(of_set), numbers, strict=True)
        clocks = {(i, j): Clock(*one) for (_, i, j), one in of_pairs}
        expected |= {(number, *triple): 1e3 * s for triple, s in closures_s(clocks).items()}
    there = list(zip(triples["data_set"], triples["cameras"], strict=True))
    if there != [(number, "-".join(map(str, triple))) for number, *triple in expected]:
        yield "not each triple of which all pairs are answered is there once"
        return
    for (key, closes_ms), there_ms in zip(expected.items(), triples["closure_ms"], strict=True):
        keys = [(key[0], *pair) for pair in combinations(key[1:], 2)]
        if affine.issuperset(keys) and not abs(closes_ms - there_ms) <= _CLOSURE_MS:
            yield f"data set {key[0]}, {key[1:]}: closes to {there_ms} ms, not as its pairs do"
        most_ms |= {one: max(most_ms.get(one, 0.0), abs(there_ms)) for one in keys}
    yield from _unlike(pairs, "closure_ms", pd.Series(most_ms), np.nan)


def _stray_faults(results: Results) -> Iterator[str]:
    strays = results.table(STRAYS)
    for _, knots in strays.groupby(KEY):
        key, times_s, strays_ms = _keys(knots)[0], knots["t_s"], knots["stray_ms"]
        if len(knots) < 2 or np.ptp(np.diff(times_s)) > _KNOT_S:
            yield f"the knots of {key} are not several, evenly spaced"
        # Strays are the residuals of the best affine clock: they have no mean and no slope.
        elif not np.abs(np.polyval(np.polyfit(times_s, strays_ms, 1), times_s)).max() <= _AFFINE_MS:
            yield f"the strays of {key} are not beside an affine clock"
    most_ms = strays["stray_ms"].abs().groupby([strays[one] for one in KEY]).max()
    yield from _unlike(results.table(PAIRS), "most_stray_ms", most_ms, 0.0)


def _path_faults(results: Results) -> list[str]:
    there = list(results.table(PATHS)["data_set"])
    return [] if there == list(DATA_SETS) else [f"{PATHS}.csv has not each data set once"]


def _unlike(
    pairs: pd.DataFrame, column: str, others: "pd.Series[float]", default: float
) -> Iterator[str]:
    """Compare a column of the pairs with what another table gives for it."""
    here = pairs.set_index(KEY)[column]
    both = pd.DataFrame({"here": here, "there": others}).reset_index(names=KEY)
    both["there"] = both["there"].fillna(default)
    off = ~np.isclose(both["here"], both["there"], _LAST_DIGIT, 1e-6, equal_nan=True)
    wrong = both[off]
    for key, mine, theirs in zip(_keys(wrong), wrong["here"], wrong["there"], strict=True):
        yield f"{key}: {column} is {mine} in the pairs, {theirs} here"


# --- What pages quote ---


def largest_closure(results: Results, number: int) -> str:
    """Say by how much the clocks of three cameras contradict each other at most."""
    closures_ms = _closures_ms(results, number)
    return f"{np.abs(closures_ms).max():.0f} ms" if len(closures_ms) else "none"


def largest_difference(results: Results, with_shifted: bool) -> str:
    """Give how far pairs of constant rate are off the published clocks, with SHIFTED or not."""
    rows = _constant(results)
    if not with_shifted:
        rows = rows[(rows["camera_1"] != SHIFTED) & (rows["camera_2"] != SHIFTED)]
    return f"{np.abs(rows['from_truth_ms']).max():.0f} ms"


def apart(results: Results) -> str:
    """Give the mean difference of SHIFTED's clock from the published one over its pairs."""
    rows = _constant(results)
    from_first, from_second = (rows[rows[f"camera_{k}"] == SHIFTED] for k in (1, 2))
    off_ms = [*-from_first["from_truth_ms"], *from_second["from_truth_ms"]]
    return f"{np.mean(off_ms):.0f} ms"


def readouts_of(results: Results, camera: int) -> str:
    """Give the range of a camera's readouts over its pairs, and the largest stated deviation."""
    rows, found = results.rows(PAIRS, data_set=WITH_TRUTH), []
    for k in (1, 2):
        of_camera = rows[rows[f"camera_{k}"] == camera]
        found.append(of_camera[[f"readout_{k}_ms", f"readout_{k}_std_ms"]].to_numpy())
    (low_ms, _), (high_ms, std_ms) = (of(np.vstack(found), axis=0) for of in (np.nanmin, np.nanmax))
    return f"{low_ms:.0f} to {high_ms:.0f} ms (1 sigma up to {std_ms:.0f} ms)"


def rate(results: Results, camera: int) -> str:
    """Give the rate of a camera's clock over camera 0's, which counts frames at a constant rate."""
    of = {"data_set": WITH_TRUTH, "camera_1": 0, "camera_2": camera}
    return f"{1.0 + PPM * results.value(PAIRS, 'skew_ppm', **of):.4f}"


def strays_range(results: Results) -> str:
    """Give the range of the largest strays of pairs with a camera of VARIABLE_RATES."""
    rows = results.rows(PAIRS, data_set=WITH_TRUTH)
    rows = rows[_of_some(rows, VARIABLE_RATES) & rows["status"].isin(OFFSET_GIVEN)]
    return f"{rows['most_stray_ms'].min():.0f} to {rows['most_stray_ms'].max():.0f} ms"


def pairs_table(results: Results) -> str:
    """Lay out, by data set, how many pairs are answered, how they agree, and how long it took."""
    body = []
    for number in DATA_SETS:
        rows = results.rows(PAIRS, data_set=number)
        is_tried, seconds = _of_some(rows, UNKNOWN_RATES), rows["seconds"]
        closures = f"{len(_closures_ms(results, number))}, {largest_closure(results, number)}"
        body.append({
            "data set": str(number),
            "pairs answered": f"{int(rows['status'].isin(OFFSET_GIVEN).sum())} of {len(rows)}",
            "triples, most open": closures,
            "median deviation": f"{np.median(rows['t_d_std_ms']):.1f} ms",
            "longest pair": f"{seconds[~is_tried].max():.0f} s",
            "with a search of rates": f"{seconds[is_tried].max():.0f} s" if is_tried.any() else "",
        })  # fmt: skip
    return markdown_table(pd.DataFrame(body))


def paths_table(results: Results) -> str:
    """Lay out the errors of each path by RTK, and beside them those of mvus."""
    paths = results.table(PATHS)
    off_ms, mvus = paths["most_from_truth_ms"], paths["data_set"].map(MVUS)
    off = off_ms.map(lambda ms: f"{ms:.0f} ms" if np.isfinite(ms) else "")
    shown = paths.assign(off=off, seen=100 * paths["coverage"], mvus=mvus)
    return shown_table(shown, {
        "set": "{data_set}",
        "cameras": "{cameras}",
        "RMSE / median / most": "{rmse_m:.3f} / {median_m:.3f} / {max_m:.2f} m",
        "RTK": "{n_rtk}",
        "seen": "{seen:.0f} %",
        "clocks off": "{off}",
        "residual": "{rms_px:.2f} px",
        "time": "{pairs_s:.0f} + {network_s:.0f} s",
        "mvus: RMSE, RTK": "{mvus[0]:.3f} m, {mvus[1]}",
    })  # fmt: skip


def _closures_ms(results: Results, number: int) -> Array:
    """Give the closures (k,) of a data set's triples, of which there may be none."""
    return results.table(TRIPLES).query(f"data_set == {number}")["closure_ms"].to_numpy(np.float64)


def _constant(results: Results) -> pd.DataFrame:
    """Give the answered pairs with published clocks of which both cameras' rates are constant."""
    rows = results.rows(PAIRS, data_set=WITH_TRUTH)
    given = rows["status"].isin(OFFSET_GIVEN) & rows["from_truth_ms"].notna()
    return rows[~_of_some(rows, VARIABLE_RATES) & given]


def _of_some(rows: pd.DataFrame, cameras: Container[tuple[int, int]]) -> "pd.Series[bool]":
    """Return which pairs have one of some cameras, named by data set and number."""
    found = [any((number, k) in cameras for k in pair) for number, *pair in _keys(rows)]
    return pd.Series(found, index=rows.index)


STUDIES = (
    Study(
        "real",
        "Public drone-tracking data sets",
        lambda: (),
        SCORED,
        Runs(f"{PAIRS}.csv", tuple(KEY), numbered=False, digits=_DIGITS),
        (
            *(Made(f"{name}.csv", None) for name in (TRIPLES, STRAYS, PATHS)),
            *(Made(PATH_FIGURE.format(number), None) for number in DATA_SETS),
            Made(OFFSETS_FIGURE, real_figure),
        ),
        numbers={
            "real.closure.4": partial(largest_closure, number=WITH_TRUTH),
            "real.off": partial(largest_difference, with_shifted=True),
            "real.off.others": partial(largest_difference, with_shifted=False),
            "real.camera1.apart": apart,
            "real.camera1.readouts": partial(readouts_of, camera=SHIFTED),
            "real.camera1.rate": partial(rate, camera=SHIFTED),
            "real.camera3.rate": partial(rate, camera=3),
            "real.readouts": quoted_of(PAIRS, "by_readouts_ms", "{most:.0f} ms"),
            "real.strays": strays_range,
            "table.real.pairs": pairs_table,
            "table.real.paths": paths_table,
        },
        checks=(
            (
                "statuses are those of estimates",
                no_row(PAIRS, f"status not in {[*map(str, Status)]}"),
            ),
            ("clocks are models of ours", no_row(PAIRS, f"clock not in {[*CLOCKS]}")),
            ("each pair is there once, with an offset or a reason", _pair_faults),
            ("triples are of answered pairs and close as these say", _triple_faults),
            ("knots are of pairs and stray as these say", _stray_faults),
            ("each data set has a path", _path_faults),
            ("a coverage is a share", no_row(PATHS, "coverage < 0 or coverage > 1")),
            ("a mean is at most an RMSE", no_row(PATHS, "mean_m > rmse_m")),
            ("an RMSE is at most a maximum", no_row(PATHS, "rmse_m > max_m")),
        ),
        config=config(),
        command=COMMAND,
        how=How.GIVEN,
    ),
)
