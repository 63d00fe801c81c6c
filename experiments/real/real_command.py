"""A folder of public data sets in, tables of pairs and paths, and figures, out: `ssac real`."""

import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer

from experiments.figures.style import save_png
from experiments.paper.checksums import record_checksums
from experiments.real.drawing import OFFSETS_FIGURE, real_figure
from experiments.real.pairs import COMMAND, PAIRS_FILE, STRAYS_FILE, real_config, run_pairs
from experiments.real.paths import PATH_FIGURE, PATHS_FILE, run_paths
from experiments.run.provenance import save_provenance
from ssac.compare.figure import save_figure
from ssac.errors import SsacError
from ssac.estimate import Status
from ssac.files.whole_file import whole_file

RESULTS = Path("results")


def real_command(
    data: Annotated[
        Path,
        typer.Argument(
            metavar="DATA", help="Folder with dataset1 ... and calibration.", show_default=False
        ),
    ],
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Where to write the tables.")
    ] = RESULTS,
) -> None:
    """Synchronise every pair, and solve all cameras at once, of drone-tracking's sets 1, 2 and 4.

    The data are not part of this suite: github.com/CenekAlbl/drone-tracking-datasets.
    """
    if not out.is_dir():
        raise SsacError(f"{out}: there is no such folder: make it, or name another")
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as work:
        tables = run_pairs(data, Path(work), lambda line: typer.echo(line, err=True))
        paths, found = run_paths(data, Path(work), lambda line: typer.echo(line, err=True))
    seconds = time.perf_counter() - start
    tables = {**tables, PATHS_FILE: paths}
    for name, table in tables.items():
        with whole_file(out / name) as temporary:
            table.to_csv(temporary, index=False, float_format="%.8g", lineterminator="\n")
        save_provenance(out / name, COMMAND, real_config(), seconds, None)
    save_png(real_figure(tables[PAIRS_FILE], tables[STRAYS_FILE]), out / OFFSETS_FIGURE)
    figures = [out / PATH_FIGURE.format(number) for number in found]
    for figure, comparison in zip(figures, found.values(), strict=True):
        save_figure(figure, comparison)
    record_checksums(out, [*(out / name for name in tables), out / OFFSETS_FIGURE, *figures])
    statuses = tables[PAIRS_FILE].status
    answered = statuses.isin([str(status) for status in Status if status.has_offset]).sum()
    typer.echo(f"{answered} of {len(statuses)} pairs answered; {out / PAIRS_FILE}")
