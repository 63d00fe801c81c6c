"""Runs, tables and comparison in; `results/README.md` out: the numbers beside the paper's, to read.

Every mean in it also stands in one of the CSV files.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from experiments.lab.markdown import markdown_table, means_with_stds, number, paragraph
from experiments.paper.comparison import RULE, SIZE_RULE
from experiments.paper.esim import method_order, pose_methods
from experiments.paper.more_flights import Record, flights_section, label, records
from experiments.paper.published import PUBLISHED_ERRORS, PUBLISHED_RUNS
from experiments.paper.quantities import ERRORS, POSE_ERRORS, T_D_ERROR
from experiments.paper.summary import VERDICTS, summary_table

_RATIO_MARK = 1.0
"""The ratio of ours to the paper's is to be at most this, of each error of `ssac` in each table."""


def results_page(
    runs: pd.DataFrame,
    tables: Mapping[float, pd.DataFrame],
    comparison: pd.DataFrame,
    provenance: Mapping[str, Any],
) -> str:
    """Write the page.

    Parameters
    ----------
    runs
        As of `esim.ordered_runs`.
    tables
        As of `esim.esim_tables`.
    comparison
        As of `comparison.comparison_table`.
    provenance
        Of the runs.
    """
    summary = summary_table(comparison)
    sections = [
        _opening(runs, tables),
        _against_the_paper(summary),
        *flights_section(runs, comparison, summary),
        _marks(tables, comparison, summary),
    ]
    sections += [
        _flights(runs, duration_s, table, comparison) for duration_s, table in tables.items()
    ]
    sections += [_differences(comparison), _failures(runs), _making(provenance)]
    return "\n\n".join(sections) + "\n"


def _opening(runs: pd.DataFrame, tables: Mapping[float, pd.DataFrame]) -> str:
    flights = " and ".join(
        f"{of_duration['flight'].nunique()} of {duration_s:g} s"
        for duration_s, of_duration in runs.groupby("duration_s")
    )
    n_recordings = len(runs[["duration_s", "angle_deg", "flight"]].drop_duplicates())
    files = " and ".join(f"`esim_{duration_s:g}.csv`" for duration_s in tables)
    text = paragraph(
        f"""Flights at each angle: {flights}; {n_recordings} recordings in all, each of a different
        flight. Angles and durations are therefore independent of each other, but all methods and
        all offsets of an angle share the same flights: an offset is only added to camera 2's
        timestamps. To make the recording of a row of `runs.csv`, give its columns angle_deg,
        duration_s, t_d_ms / 1000 and seed to `ssac simulate OUT --angle ANGLE --duration DURATION
        --t-d OFFSET --seed SEED`. Numbers are mean errors ± standard deviations (dividing by the
        number of runs, as the paper does) of the runs that gave an estimate. The tables are
        {files}; every run is in `runs.csv`, every comparison with its interval in
        `comparison.csv`, the paper's numbers in `published/`. The other files of this folder are
        listed in [docs/results.md](../docs/results.md); FILE.csv has its commit, versions and
        configuration in FILE.provenance.json, and `SHA256SUMS` the checksums of all."""
    )
    return f"# The paper's simulation tables\n\n{text}"


def _against_the_paper(summary: pd.DataFrame) -> str:
    rows = [
        [
            label(row["quantity"]), f"{row['duration_s']:g} s", str(row["cells"]),
            *(str(row[word]) for word in VERDICTS), number(row["ratio"], 2),
            _interval(row), f"{number(row['ratio_min'], 2)} to {number(row['ratio_max'], 2)}",
            f"{number(100 * row['visible'], 0)} %",
        ]
        for row in records(summary)
    ]  # fmt: skip
    header = ["mean error", "flights", "cells", *VERDICTS, "ours / paper", "95 %",
              "in single cells", "visible from"]  # fmt: skip
    return "\n\n".join(
        [
            "## Against the paper",
            markdown_table(header, rows),
            paragraph(
                """*ours / paper*: ratio of the geometric means over the cells, with its 95 %
                interval. *visible from*: the smallest difference that the rule detects in the
                median cell, as a share of the published mean. These rows are also in
                `comparison_summary.csv`."""
            ),
            paragraph(f"The rule for a cell. {RULE}."),
            paragraph(
                f"""If both sides drew from one distribution, up to 5 % of the cells would still not
                agree, by chance. Cells of different angles or durations are independent of each
                other, but the three offsets of an angle share its flights, in the paper evidently
                too (its correlation methods err alike at 5 and 50 ms), so they agree or differ
                together. The published numbers rest on {PUBLISHED_RUNS} runs each. A smaller error
                of a correlation method counts as better by the same rule, though in a reproduction
                it is a difference."""
            ),
        ]
    )


def _interval(row: Record) -> str:
    """Say between which ratios that of a summary's row lies."""
    low, high = row["ratio"] / row["factor"], row["ratio"] * row["factor"]
    return f"{number(low, 2)} to {number(high, 2)}"


def _marks(
    tables: Mapping[float, pd.DataFrame], comparison: pd.DataFrame, summary: pd.DataFrame
) -> str:
    ssac = comparison[comparison["quantity"] == "ssac_t_d_error_ms"]
    sized, lower = ssac["paper_size_or_better"] == "yes", ssac["mean_at_most_published"] == "yes"
    missed = "; ".join(
        f"{row['duration_s']:g} s, {row['angle_deg']:g} deg, {row['t_d_ms']:g} ms"
        for row in records(ssac[~sized])
    )
    items = [
        f"""- `ssac`, mean t_d error of the paper's size or better: {sized.sum()} of {len(ssac)}
        cells{f" (not: {missed})" if missed else ""}. {SIZE_RULE}. Our mean is at most the published
        one in {lower.sum()} cells."""
    ]
    of_ssac = summary[summary["quantity"].str.startswith("ssac_")]
    ratios = ", ".join(
        f"{label(row['quantity']).partition(' ')[2].partition(' ')[0]} {number(row['ratio'], 2)} "
        f"over {row['duration_s']:g} s"
        for row in records(of_ssac)
    )
    if ratios:
        items.append(
            f"""- `ssac`, ours / paper over the cells of a table at most {_RATIO_MARK:g}:
            {(of_ssac["ratio"] <= _RATIO_MARK).sum()} of {len(of_ssac)} ({ratios})."""
        )
    for column_of_runs, error in ERRORS.items():
        column = f"tangency_{column_of_runs}_mean"
        values = [table[column] for table in tables.values() if column in table]
        if values:
            means = pd.concat(values)
            items.append(
                f"""- `tangency`, mean {error.heading} error at most {error.mark:g}:
                {(means <= error.mark).sum()} of {len(means)} cells; the largest is
                {number(means.max(), 3)}."""
            )
    items.append(
        """- `zncc_e` and `zncc_f`, mean t_d error from tens of ms at 30 deg to hundreds at 150 deg
        (means over the offsets):"""
    )
    angles = [f"{angle:g} deg" for angle in sorted(comparison["angle_deg"].unique())]
    growth = markdown_table(["method", "flights", "", *angles, "met"], _growth_rows(comparison))
    return "\n\n".join(["## Marks", "\n".join(map(paragraph, items)), growth])


def _growth_rows(comparison: pd.DataFrame) -> list[list[str]]:
    """Mean errors of the correlation methods by angle, ours and the paper's."""
    rows = []
    chosen = comparison[comparison["quantity"].str.startswith("zncc")]
    for (name, duration_s), part in chosen.groupby(["quantity", "duration_s"]):
        means = part.groupby("angle_deg")[["ours_mean", "published_mean"]].mean()
        first, last = means["ours_mean"].iloc[0], means["ours_mean"].iloc[-1]
        met = "yes" if 10 <= first < 100 <= last < 1000 else "no"
        method = label(str(name)).partition(" ")[0]
        for who, column, verdict in (("ours", "ours_mean", met), ("paper", "published_mean", "")):
            values = [number(value, 0) for value in means[column]]
            rows.append([method, f"{duration_s:g} s", who, *values, verdict])
    return rows


def _flights(
    runs: pd.DataFrame, duration_s: float, table: pd.DataFrame, comparison: pd.DataFrame
) -> str:
    """Show one of the paper's tables, and the methods that it does not have."""
    part = comparison[comparison["duration_s"] == duration_s]
    published = {quantity.method for quantity in PUBLISHED_ERRORS} if len(part) else set()
    methods = method_order(runs.loc[runs["duration_s"] == duration_s, "method"])
    others = [name for name in methods if name not in published]
    posed = [name for name in pose_methods(runs) if name in others]
    pieces = [f"## Flights of {duration_s:g} s"]
    if len(part):
        ours = [quantity.name for quantity in PUBLISHED_ERRORS if quantity.method == "ssac"]
        correlated = [quantity.name for quantity in PUBLISHED_ERRORS if quantity.method != "ssac"]
        pieces += [
            "Mean errors of the paper's methods, ours and the paper's:",
            _beside_the_paper(part, ours, 2),
            _beside_the_paper(part, correlated, 1),
        ]
    if others:
        columns = [(name, T_D_ERROR.column) for name in others]
        pieces += ["Mean errors of t_d of the other methods:", _others(table, columns)]
    if posed:
        columns = [(name, error) for name in posed for error in POSE_ERRORS]
        pieces += ["Mean errors of the pose by the other methods:", _others(table, columns)]
    return "\n\n".join(pieces)


def _beside_the_paper(part: pd.DataFrame, names: Sequence[str], decimals: int) -> str:
    """Ours, the paper's and the verdict for some quantities, one row for each angle and offset."""
    header = ["angle [deg]", "t_d [ms]"]
    columns: list[list[str]] = []
    for name in names:
        chosen = part[part["quantity"] == name]
        if chosen.empty:
            continue
        columns = columns or _places(chosen)
        header += [label(name), "paper", "verdict"]
        columns += [
            means_with_stds(chosen["ours_mean"], chosen["ours_std"], decimals),
            means_with_stds(chosen["published_mean"], chosen["published_std"], decimals),
            list(chosen["verdict"]),
        ]
    return markdown_table(header, list(zip(*columns, strict=True)))


def _others(table: pd.DataFrame, errors: Sequence[tuple[str, str]]) -> str:
    """Errors (method, error) of the table, one row for each angle and offset."""
    header = ["angle [deg]", "t_d [ms]"]
    columns = _places(table)
    for method, error in errors:
        header.append(label(f"{method}_{error}"))
        means, stds = (table[f"{method}_{error}_{part}"] for part in ("mean", "std"))
        decimals = 1 if means.max() >= 10 else 3 if error == T_D_ERROR.column else 2
        cells = means_with_stds(means, stds, decimals)
        n_ok = table["n_runs"] - table[f"{method}_failed"]
        columns.append(
            [
                cell if n == n_runs or not n else f"{cell} ({n} runs)"
                for cell, n, n_runs in zip(cells, n_ok, table["n_runs"], strict=True)
            ]
        )
    return markdown_table(header, list(zip(*columns, strict=True)))


def _differences(comparison: pd.DataFrame) -> str:
    """List the cells that differ, with the reasons known."""
    rows = [
        [
            label(row["quantity"]),
            f"{row['duration_s']:g} s",
            f"{row['angle_deg']:g}",
            f"{row['t_d_ms']:g}",
            number(row["ours_mean"], 3),
            number(row["published_mean"], 2),
            f"{number(row['difference_low'], 3)} to {number(row['difference_high'], 3)}",
            row["note"] or "not known",
        ]
        for row in records(comparison[comparison["verdict"] == "differs"])
    ]
    header = ["mean error", "flights", "angle [deg]", "t_d [ms]", "ours", "paper",
              "95 % interval of the difference", "reason"]  # fmt: skip
    return "## Cells that differ\n\n" + (markdown_table(header, rows) if rows else "None.")


def _failures(runs: pd.DataFrame) -> str:
    """Count the runs that gave no estimate, with one reason of each kind."""
    failed = runs[runs["status"] != "ok"]
    text = f"## Runs without an estimate\n\n{len(failed)} of {len(runs)}"
    if failed.empty:
        return text + "."
    groups = failed.groupby(["method", "duration_s", "status"])
    rows = [
        [f"`{method}`", f"{duration_s:g} s", status, str(len(group)), group["reason"].iloc[0]]
        for (method, duration_s, status), group in groups
    ]
    header = ["method", "flights", "status", "runs", "reason of the first"]
    return f"{text}; they do not enter the means.\n\n{markdown_table(header, rows)}"


def _making(provenance: Mapping[str, Any]) -> str:
    gl = provenance.get("gl") or {}
    packages = provenance.get("versions", {})
    versions = ", ".join(f"{name} {version}" for name, version in packages.items())
    wall_time_s = provenance.get("wall_time_s")
    took = "" if wall_time_s is None else f" in {wall_time_s / 60:.1f} minutes"
    if "recordings_simulated" in provenance:
        took += f" ({provenance['recordings_simulated']} recordings simulated for it)"
    text = paragraph(
        f"""`{provenance.get("command", "?")}` at commit {provenance.get("commit", "?")}{took};
        rendered by {gl.get("renderer", "?")}, {gl.get("backend", "?")}; {versions}. `make verify`
        makes this page, the tables and the comparison again from `runs.csv`, and repeats a random
        choice of runs from nothing."""
    )
    return f"## How it was made\n\n{text}"


def _places(rows: pd.DataFrame) -> list[list[str]]:
    return [[f"{value:g}" for value in rows[name]] for name in ("angle_deg", "t_d_ms")]
