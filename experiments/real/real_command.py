"""A folder of public data sets in, tables of pairs and paths, and figures, out: `ssac real`."""

import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer

from experiments.lab.command import check_is_folder
from experiments.lab.files import record_checksums, save_png
from experiments.lab.provenance import save_provenance
from experiments.real.data_sets import COMMAND, DataSet, data_sets, real_config
from experiments.real.drawing import OFFSETS_FIGURE, real_figure
from experiments.real.pairs import PAIRS_FILE, STRAYS_FILE, pair_tables
from experiments.real.paths import PATH_FIGURE, PATHS_FILE, Row, path_of, path_table
from ssac.estimate import Status
from ssac.files.whole_file import whole_file
from ssac.pipeline.plots import save_comparison

RESULTS = Path("results")


def real_command(
    data: Annotated[
        Path,
        typer.Argument(
            metavar="DATA", help="Folder with dataset1 ... and calibration.", show_default=False
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the tables.")] = RESULTS,
) -> None:
    """Synchronise every pair, and solve all cameras at once, of drone-tracking's sets 1, 2 and 4.

    The data are not part of this suite: github.com/CenekAlbl/drone-tracking-datasets.
    """
    check_is_folder(out)
    start_s, paths = time.perf_counter(), list[Row]()
    sets, written = list[DataSet](), list[Path]()
    with tempfile.TemporaryDirectory() as work:
        for one in data_sets(data, Path(work), _say):
            sets.append(one)
            row, comparison = path_of(one)
            paths.append(row)
            written.append(out / PATH_FIGURE.format(one.number))
            save_comparison(written[-1], comparison)
            _say(
                f"{one.number}: {row['cameras']} cameras, RMSE {row['rmse_m']:.3f} m at "
                f"{row['n_rtk']} samples of RTK, {row['network_s']:.0f} s"
            )
    tables = {**pair_tables(sets), PATHS_FILE: path_table(paths)}
    seconds = time.perf_counter() - start_s
    for name, table in tables.items():
        with whole_file(out / name) as temporary:
            table.to_csv(temporary, index=False, float_format="%.8g", lineterminator="\n")
        save_provenance(out / name, COMMAND, real_config(), seconds, None)
        written.append(out / name)
    written.append(out / OFFSETS_FIGURE)
    save_png(real_figure(tables[PAIRS_FILE], tables[STRAYS_FILE]), written[-1])
    record_checksums(out, written)
    statuses = tables[PAIRS_FILE].status
    answered = statuses.isin([str(status) for status in Status if status.has_offset]).sum()
    typer.echo(f"{answered} of {len(statuses)} pairs answered; {out / PAIRS_FILE}")


def _say(line: str) -> None:
    typer.echo(line, err=True)
