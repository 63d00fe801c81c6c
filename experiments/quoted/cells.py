"""Results in, the numbers that the pages quote in their sentences out, each under a name.

A name's function takes the committed results and gives the text as it stands in the page. Adding a
number is adding a line to `NUMBERS`; nothing here writes or judges.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import partial

import numpy as np
from scipy.stats import gmean

from experiments.lab.results import Committed
from experiments.paper.comparison import VERDICTS
from experiments.paper.grids import ANGLES_DEG, DURATIONS_S, TABLES
from experiments.paper.quantities import ERRORS, NOISY_T_D_MARK_MS, T_D_ERROR
from experiments.quoted.marks import MARK_NUMBERS
from experiments.quoted.real import REAL_NUMBERS
from experiments.studies.catalogue import ABLATIONS
from experiments.studies.refusal import METHOD_NAMES as REFUSING_METHODS

METHODS = ("ssac", "ssac-known", "joint", "joint-known", "tangency", "tangency-known")
SYMBOLS = {error.symbol: error for error in ERRORS.values()}
"""The errors by what they are called in the names here."""

COVERAGE_MARK = 0.93
"""Intervals of 95 % shall hold the truth in at least this share of the flights."""

MUST_NOT_BE = ("unclear", "traceback", "abort", "hang", "over_memory", "wrong")
"""How no damaged input may end, as columns of reliability.csv."""

PUBLISHED = {  # of the quantities of comparison.csv
    "ssac.t_d": "ssac_t_d_error_ms",
    "ssac.R": "ssac_r_error_deg",
    "ssac.t": "ssac_t_error_deg",
    "zncc_e.t_d": "zncc_e_t_d_error_ms",
    "zncc_f.t_d": "zncc_f_t_d_error_ms",
}

Number = Callable[[Committed], str]


def digits(value: float) -> str:
    """Show two significant digits, without an exponent."""
    if not np.isfinite(value):
        return "none"
    rounded = f"{value:.1e}"
    return f"{float(rounded):.{max(1 - int(rounded.split('e')[1]), 0)}f}"


def listed(texts: Iterable[str]) -> str:
    """Join as in a sentence: "a, b and c"."""
    *first, last = texts
    return f"{', '.join(first)} and {last}" if first else last


def verdicts(results: Committed, quantity: str) -> str:
    """Say how many cells of a published quantity agree, are better, and differ."""
    rows = results.rows("comparison", quantity=quantity)
    counts = {word: int((rows["verdict"] == word).sum()) for word in VERDICTS}
    words = (f"{n} {_plural(word, n)}" for word, n in counts.items() if n)
    return f"of {len(rows)} cells {listed(words)}"


def paper_size(results: Committed) -> str:
    """Say in how many cells the t_d error of `ssac` is of the paper's size or better."""
    rows = results.rows("comparison", quantity="ssac_t_d_error_ms")
    return f"{int((rows['paper_size_or_better'] == 'yes').sum())} of {len(rows)} cells"


def ratio(results: Committed, quantity: str, duration_s: float) -> str:
    """Ours over the paper's, of the geometric means over the cells of one table."""
    of = {"quantity": quantity, "duration_s": duration_s}
    ours = results.column("comparison", "ours_mean", **of)
    return f"{gmean(ours) / gmean(results.column('comparison', 'published_mean', **of)):.2f}"


def ratio_interval(results: Committed, quantity: str, duration_s: float) -> str:
    """Say between which ratios `ratio` lies with 95 %."""
    of = {"quantity": quantity, "duration_s": duration_s}
    value = results.value("comparison_summary", "ratio", **of)
    factor = results.value("comparison_summary", "factor", **of)
    return f"{value / factor:.2f} to {value * factor:.2f}"


def changed(results: Committed, quantity: str) -> str:
    """Say in how many cells our first flights alone, as many as the paper's, judge otherwise."""
    rows = results.rows("comparison", quantity=quantity)
    return f"{int((rows['verdict'] != rows['first_verdict']).sum())} of {len(rows)} cells"


def cell_means(results: Committed, method: str, error: str) -> list[float]:
    """Return a method's mean errors in all cells of both tables."""
    return [v for name in TABLES for v in results.column(name, f"{method}_{error}_mean")]


def mean_range(results: Committed, method: str, symbol: str) -> str:
    """Range of a method's mean errors over the cells of both tables."""
    error = SYMBOLS[symbol]
    means = cell_means(results, method, error.column)
    return f"{min(means):.2f} to {max(means):.2f} {error.unit}"


def marks(_: Committed) -> str:
    """Name the marks of the mean errors of `tangency`, which hold in every cell."""
    return listed(f"{error.mark:g} {error.unit}" for error in ERRORS.values())


def mark_met(results: Committed, symbol: str) -> str:
    """Say in how many cells the mean error of `tangency` is at most its mark."""
    error = SYMBOLS[symbol]
    means = cell_means(results, "tangency", error.column)
    return f"{sum(mean <= error.mark for mean in means)} of {len(means)} cells"


def largest(results: Committed, symbol: str) -> str:
    """Say what the largest mean error of `tangency` in a cell is."""
    error = SYMBOLS[symbol]
    return f"{max(cell_means(results, 'tangency', error.column)):.3f} {error.unit}"


def covered(results: Committed, method: str, quantity: str) -> str:
    """Share of the flights whose 95 % interval, or region, holds the truth."""
    of = {"method": method, "quantity": quantity, "angle_deg": "all"}
    return f"{100 * results.value('coverage', 'coverage_95', **of):.1f} %"


def below_the_mark(results: Committed) -> str:
    """List the methods and quantities whose 95 % intervals hold the truth less often than 93 %."""
    table = results.table("coverage")
    low = table[(table["angle_deg"] == "all") & (table["coverage_95"] < COVERAGE_MARK)]
    found = [
        f"{100 * row['coverage_95']:.0f} % ({row['quantity']} of `{row['method']}`)"
        for row in low.to_dict("records")
    ]
    return listed(found) if found else "nowhere"


def coverage_flights(results: Committed) -> str:
    """Count the flights of the study of coverage."""
    of = {"method": "joint", "quantity": "t_d", "angle_deg": "all"}
    return f"{results.value('coverage', 'n_runs', **of):.0f}"


def means_by_angle(results: Committed, name: str, method: str) -> str:
    """Mean errors of t_d from 30 to 150 deg, of a file of runs, those that gave an estimate."""
    means = [
        np.nanmean(
            results.column(name, T_D_ERROR.column, method=method, status="ok", sim__angle_deg=angle)
        )
        for angle in ANGLES_DEG
    ]
    return listed(digits(float(mean)) for mean in means) + " ms"


def largest_with_noise(results: Committed) -> str:
    """Largest mean error of `tangency` in a cell of the tables' flights with a DAVIS346's noise."""
    means = results.column("ablation_davis346", "t_d_error_ms_mean", method="tangency")
    return f"{np.nanmax(means):.2f} ms"


def noisy_mark(_: Committed) -> str:
    """Name the mark of t_d with a DAVIS346's noise, likewise in every cell."""
    return f"{NOISY_T_D_MARK_MS:g} ms"


def table_runs(results: Committed) -> str:
    """Say how many runs of the tables gave an estimate."""
    status = results.table("runs")["status"]
    return f"{int((status == 'ok').sum())} of {len(status)} runs"


def refusal_recordings(results: Committed) -> str:
    """Count the recordings of the study of refusal."""
    return str(len(results.rows("refusal_runs", method="joint")))


def refusal_wrong(results: Committed, method: str) -> str:
    """Count the confident wrong answers of one method in the study of refusal."""
    return f"{results.column('refusal', 'confident_wrong', method=method).sum():.0f}"


def ordinary_answered(results: Committed) -> str:
    """Say how many runs of the study of refusal on ordinary flights gave an offset."""
    rows = results.rows("refusal", kind="ordinary")
    return f"{int(rows['offset_given'].sum())} of {int(rows['runs'].sum())}"


def damaged(results: Committed, columns: tuple[str, ...]) -> str:
    """Count the damaged inputs that ended in one of these ways."""
    of_all = (results.value("reliability", column, input="all") for column in columns)
    return f"{sum(of_all):.0f}"


def zncc_means(results: Committed, column: str, method: str, duration_s: float) -> str:
    """Mean errors of a correlation method from 30 to 150 deg, over the table's offsets."""
    of = {"quantity": f"{method}_t_d_error_ms", "duration_s": duration_s}
    means = (
        results.column("comparison", column, angle_deg=angle, **of).mean() for angle in ANGLES_DEG
    )
    return listed(f"{mean:.0f}" for mean in means) + " ms"


def bound_share(results: Committed, method: str) -> str:
    """Range over the cells of the bound of t_d over the error, for white noise."""
    shares = 100 * results.column("efficiency", "t_d_efficiency", method=method)
    return f"{shares.min():.0f} to {shares.max():.0f} %"


def minutes(results: Committed, name: str) -> str:
    """Wall time of the command that wrote a file, in minutes."""
    value = results.minutes(name)
    return f"{value:.0f}" if value >= 1.95 else f"{value:.1f}"


def minutes_of(results: Committed, names: tuple[str, ...]) -> str:
    """Wall time of several commands together."""
    return f"{sum(results.minutes(name) for name in names):.0f}"


def bench(results: Committed, row: str, scale: float = 1.0, decimals: int = 0) -> str:
    """Return a measured figure of the benchmark."""
    return f"{scale * results.value('bench', 'value', name=row):.{decimals}f}"


def _plural(verdict: str, n: int) -> str:
    one = {"agrees": "agrees", "better": "is better", "differs": "differs"}
    many = {"agrees": "agree", "better": "are better", "differs": "differ"}
    return one[verdict] if n == 1 else many[verdict]


_TIMED = (
    *("bench", "comparison", "coverage", "efficiency", "fidelity", "figures"),
    "renderers",
    *("refusal", "imperfect", "marks", "tangency", "zncc"),
    *(f"ablation_{name}" for name in ABLATIONS),
)

NUMBERS: Mapping[str, Number] = {
    "paper.size": paper_size,
    **{f"paper.{q}": partial(verdicts, quantity=quantity) for q, quantity in PUBLISHED.items()},
    **{f"paper.changed.{q}": partial(changed, quantity=name) for q, name in PUBLISHED.items()},
    **{
        f"paper.{what}.{q}.{d:g}": partial(function, quantity=quantity, duration_s=d)
        for what, function in (("ratio", ratio), ("interval", ratio_interval))
        for q, quantity in PUBLISHED.items()
        for d in DURATIONS_S
    },
    **{
        f"tables.range.{m}.{s}": partial(mean_range, method=m, symbol=s)
        for m in METHODS
        for s in SYMBOLS
        if s == "t_d" or not m.endswith("-known")
    },
    "tables.runs": table_runs,
    "tables.marks": marks,
    **{f"tables.mark.{s}": partial(mark_met, symbol=s) for s in SYMBOLS},
    **{f"tables.largest.{s}": partial(largest, symbol=s) for s in SYMBOLS},
    "coverage.flights": coverage_flights,
    "coverage.below": below_the_mark,
    **{
        f"coverage.{m}.{q}": partial(covered, method=m, quantity=q)
        for m in ("joint", "tangency", "joint-known", "tangency-known")
        for q in SYMBOLS
        if q == "t_d" or not m.endswith("-known")
    },
    **{
        f"coverage.means.{m}": partial(means_by_angle, name="coverage_runs", method=m)
        for m in ("joint", "tangency")
    },
    "davis346.largest": largest_with_noise,
    "davis346.mark": noisy_mark,
    "refusal.recordings": refusal_recordings,
    **{f"refusal.wrong.{m}": partial(refusal_wrong, method=m) for m in REFUSING_METHODS},
    "refusal.ordinary": ordinary_answered,
    **{
        f"reliability.{name}": partial(damaged, columns=(name,))
        for name in ("cases", "refused", "warned", "silently_fewer")
    },
    "reliability.must_not_be": partial(damaged, columns=MUST_NOT_BE),
    **{
        f"zncc.{whose}.{m}.{d:g}": partial(zncc_means, column=column, method=m, duration_s=d)
        for whose, column in (("ours", "ours_mean"), ("paper", "published_mean"))
        for m in ("zncc_e", "zncc_f")
        for d in DURATIONS_S
    },
    **{f"bound.{m}": partial(bound_share, method=m) for m in ("ssac", "joint", "tangency")},
    **{f"minutes.{name}": partial(minutes, name=name) for name in _TIMED},
    "minutes.tables.cached": partial(
        bench, row="tables, recordings cached: all, 2 workers", scale=1 / 60, decimals=1
    ),
    "minutes.tables.nothing": partial(
        bench, row="tables, from nothing: all, 2 workers", scale=1 / 60
    ),
    "minutes.studies": partial(minutes_of, names=("efficiency", "coverage", "refusal", "tangency")),
    "bench.recordings": partial(bench, row="tables: recordings"),
    "bench.sync.tangency": partial(bench, row="sync, tangency: all but reading", decimals=2),
    **REAL_NUMBERS,
    **MARK_NUMBERS,
}
