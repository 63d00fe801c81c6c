"""Results in, the numbers that the pages quote in their sentences out, each under a name.

A name's function takes the committed results and gives the text as it stands in the page. Adding a
number is adding a line to `NUMBERS`; nothing here writes or judges.
"""

from collections.abc import Callable, Mapping
from functools import partial

from experiments.lab.markdown import listed
from experiments.lab.results import Results
from experiments.paper.grids import ANGLES_DEG, DURATIONS_S
from experiments.paper.quantities import ERRORS
from experiments.quoted.marks import MARK_NUMBERS
from experiments.quoted.real import REAL_NUMBERS
from experiments.studies.refusal import METHOD_NAMES as REFUSING_METHODS

MUST_NOT_BE = ("unclear", "traceback", "abort", "hang", "over_memory", "wrong")
"""How no damaged input may end, as columns of reliability.csv."""

METHODS = ("ssac", "ssac-known", "joint", "joint-known", "tangency", "tangency-known")
SYMBOLS = {error.symbol: error for error in ERRORS.values()}
"""The errors by what they are called in the names here."""

PUBLISHED = {  # of the quantities of comparison.csv
    "ssac.t_d": "ssac_t_d_error_ms",
    "ssac.R": "ssac_r_error_deg",
    "ssac.t": "ssac_t_error_deg",
    "zncc_e.t_d": "zncc_e_t_d_error_ms",
    "zncc_f.t_d": "zncc_f_t_d_error_ms",
}

Number = Callable[[Results], str]


def refusal_recordings(results: Results) -> str:
    """Count the recordings of the study of refusal."""
    return str(len(results.rows("refusal_runs", method="joint")))


def refusal_wrong(results: Results, method: str) -> str:
    """Count the confident wrong answers of one method in the study of refusal."""
    return f"{results.column('refusal', 'confident_wrong', method=method).sum():.0f}"


def ordinary_answered(results: Results) -> str:
    """Say how many runs of the study of refusal on ordinary flights gave an offset."""
    rows = results.rows("refusal", kind="ordinary")
    return f"{int(rows['offset_given'].sum())} of {int(rows['runs'].sum())}"


def zncc_means(results: Results, column: str, method: str, duration_s: float) -> str:
    """Mean errors of a correlation method from 30 to 150 deg, over the table's offsets."""
    of = {"quantity": f"{method}_t_d_error_ms", "duration_s": duration_s}
    means = (
        results.column("comparison", column, angle_deg=angle, **of).mean() for angle in ANGLES_DEG
    )
    return listed(f"{mean:.0f}" for mean in means) + " ms"


def damaged(results: Results, columns: tuple[str, ...]) -> str:
    """Count the damaged inputs that ended in one of these ways."""
    of_all = (results.value("reliability", column, input="all") for column in columns)
    return f"{sum(of_all):.0f}"


def bench(results: Results, row: str, scale: float = 1.0, decimals: int = 0) -> str:
    """Return a measured figure of the benchmark."""
    return f"{scale * results.value('bench', 'value', name=row):.{decimals}f}"


NUMBERS: Mapping[str, Number] = {
    "refusal.recordings": refusal_recordings,
    **{f"refusal.wrong.{m}": partial(refusal_wrong, method=m) for m in REFUSING_METHODS},
    "refusal.ordinary": ordinary_answered,
    **{
        f"zncc.{whose}.{m}.{d:g}": partial(zncc_means, column=column, method=m, duration_s=d)
        for whose, column in (("ours", "ours_mean"), ("paper", "published_mean"))
        for m in ("zncc_e", "zncc_f")
        for d in DURATIONS_S
    },
    "minutes.tables.cached": partial(
        bench, row="tables, recordings cached: all, 2 workers", scale=1 / 60, decimals=1
    ),
    "minutes.tables.nothing": partial(
        bench, row="tables, from nothing: all, 2 workers", scale=1 / 60
    ),
    **{
        f"reliability.{name}": partial(damaged, columns=(name,))
        for name in ("cases", "refused", "warned", "silently_fewer")
    },
    "reliability.must_not_be": partial(damaged, columns=MUST_NOT_BE),
    "bench.recordings": partial(bench, row="tables: recordings"),
    "bench.sync.tangency": partial(bench, row="sync, tangency: all but reading", decimals=2),
    **REAL_NUMBERS,
    **MARK_NUMBERS,
}
