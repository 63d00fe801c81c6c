"""Results of campaigns in, the tables that the pages show out as Markdown, each under a name."""

from collections.abc import Callable, Mapping

from experiments.lab.markdown import digits, markdown_table
from experiments.lab.results import Results
from experiments.quoted.physical import PHYSICAL_TABLES
from ssac.fit.covariance import NORMAL_95


def outdoor_table(results: Results) -> str:
    """Lay out what the outdoor twin's flights gave, by what was taken from the truth.

    Empty where it was not run. Errors are means, in brackets the path's largest; of t_d and skew
    how many of the stated 95 % intervals hold the truth.
    """
    if not results.has("outdoor"):
        return ""
    rows = []
    for kind, flights in results.table("outdoor").groupby("kind", sort=False):
        given = flights[flights["rmse_m"].notna()]
        held = (
            f"{(given[f'{name}_error_{unit}'] <= NORMAL_95 * given[f'{name}_std_{unit}']).sum()}"
            for name, unit in (("t_d", "ms"), ("skew", "ppm"))
        )
        rows.append(
            [
                str(kind).replace("_", " "),
                f"{len(given)} of {len(flights)}",
                f"{given['t_d_error_ms'].mean():.3f}",
                f"{given['skew_error_ppm'].mean():.2f}",
                *(f"{given[f'{name}_error_deg'].mean():.3f}" for name in ("r", "t")),
                ", ".join(held),
                f"{given['rmse_m'].mean():.3f} ({given['rmse_m'].max():.3f})",
                f"{given['icp_rmse_m'].mean():.3f}",
                f"{100 * given['coverage'].mean():.0f}",
            ]
        )
    header = [
        *("known", "answered", "t_d [ms]", "skew [ppm]", "R [deg]", "t [deg]", "held"),
        *("path [m]", "ICP [m]", "seen [%]"),
    ]
    return markdown_table(header, rows)


def network_table(results: Results) -> str:
    """Lay out what four event cameras gave, with their events and with true tracks.

    Empty where it was not run. Errors are means, in brackets the largest; of the stated regions of
    95 % how many hold the truth, of the path the share of its coordinates.
    """
    if not results.has("network"):
        return ""
    rows, told = [], 0
    for row in results.table("network").to_dict("records"):
        told = int(row["told"])
        held = ", ".join(f"{row[f'{name}_held']:.0f}" for name in ("t_d", "skew", "r", "t"))
        rows.append(
            [
                str(row["kind"]).replace("_", " "),
                *(
                    f"{row[name]:.3f} ({row[f'{name}_most']:.3f})"
                    for name in ("t_d_error_ms", "r_error_deg", "t_error_deg")
                ),
                held,
                f"{row['path_rmse_mm']:.1f} ({row['path_rmse_mm_most']:.1f})",
                digits(row["path_point_rmse_mm"]),
                f"{100 * row['path_held']:.0f}",
            ]
        )
    header = [
        *("tracks", "t_d [ms]", "R [deg]", "t [deg]", f"held of {told}"),
        *("path [mm]", "nearest", "held [%]"),
    ]
    return markdown_table(header, rows)


def network_growth_table(results: Results) -> str:
    """Lay out time and memory of ever longer flights before eight cameras; empty where not run."""
    if not results.has("network_growth"):
        return ""
    rows = [
        [
            *(f"{row[name]:.0f}" for name in ("duration_s", "points", "wall_s", "cpu_s")),
            *(f"{row[name]:.0f}" for name in ("pairs_s", "network_s", "peak_mb")),
            *(digits(row[name]) for name in ("t_d_error_ms", "path_rmse_m")),
        ]
        for row in results.table("network_growth").to_dict("records")
    ]
    header = [
        *("flight [s]", "points", "wall [s]", "one core [s]", "pairs [s]", "network [s]"),
        *("memory [MB]", "t_d, most [ms]", "path [m]"),
    ]
    return markdown_table(header, rows)


def reliability_table(results: Results) -> str:
    """Count how damaged inputs ended; empty where none were tried."""
    if not results.has("reliability"):
        return ""
    table = results.table("reliability")
    shown = ("refused", "warned", "read", "shorter", "silently_fewer")
    other = [str(name) for name in table if name not in ("input", "cases", "right", *shown)]
    rows = []
    for row in table.to_dict("records"):
        must_not_be = sum(row[name] for name in other)
        counts = [row["cases"], *(row[name] for name in shown), must_not_be]
        rows.append([str(row["input"]), *(f"{int(count)}" for count in counts)])
    header = ["input", "cases", *(name.replace("_", " ") for name in shown), "must not be"]
    return markdown_table(header, rows)


CAMPAIGN_TABLES: Mapping[str, Callable[[Results], str]] = {
    "table.network": network_table,
    "table.network.growth": network_growth_table,
    "table.outdoor": outdoor_table,
    "table.reliability": reliability_table,
    **PHYSICAL_TABLES,
}
