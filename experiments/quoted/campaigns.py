"""Results of campaigns in, the tables that the pages show out as Markdown, each under a name."""

from collections.abc import Callable, Mapping

from experiments.paper.markdown import markdown_table
from experiments.quoted.cells import digits
from experiments.quoted.committed import Committed
from experiments.quoted.physical import PHYSICAL_TABLES


def outdoor_table(results: Committed) -> str:
    """Lay out what the outdoor twin's flights gave, by what was taken from the truth.

    Empty where it was not run. Errors are means, with the largest of the path; of t_d and skew how
    many of the stated 95 % intervals hold the truth.
    """
    if not results.has("outdoor"):
        return ""
    rows = []
    for kind, flights in results.table("outdoor").groupby("kind", sort=False):
        given = flights[flights["rmse_m"].notna()]
        held = (
            f"{(given[f'{name}_error_{unit}'] <= 1.96 * given[f'{name}_std_{unit}']).sum()}"
            for name, unit in (("t_d", "ms"), ("skew", "ppm"))
        )
        rows.append(
            [
                str(kind).replace("_", " "),
                f"{len(given)} of {len(flights)}",
                *(
                    digits(float(given[column].mean()))
                    for column in ("t_d_error_ms", "skew_error_ppm", "r_error_deg", "t_error_deg")
                ),
                ", ".join(held),
                f"{given['rmse_m'].mean():.3f} ({given['rmse_m'].max():.3f})",
                f"{given['icp_rmse_m'].mean():.3f}",
                f"{given['scale_error_percent'].mean():.2f}",
                f"{100 * given['coverage'].mean():.0f}",
            ]
        )
    header = [
        *("known", "answered", "t_d [ms]", "skew [ppm]", "R [deg]", "t [deg]", "held"),
        *("path [m] (most)", "ICP [m]", "scale [%]", "seen [%]"),
    ]
    return markdown_table(header, rows)


def reliability_table(results: Committed) -> str:
    """Count how damaged inputs and disturbed sweeps ended; empty where none were tried."""
    if not results.has("reliability"):
        return ""
    table = results.table("reliability")
    shown = ("refused", "warned", "read", "shorter", "right", "silently_fewer")
    other = [str(name) for name in table if name not in ("input", "cases", *shown)]
    rows = []
    for row in table.to_dict("records"):
        must_not_be = sum(row[name] for name in other)
        counts = [row["cases"], *(row[name] for name in shown), must_not_be]
        rows.append([str(row["input"]), *(f"{int(count)}" for count in counts)])
    header = ["input", "cases", *(name.replace("_", " ") for name in shown), "must not be"]
    return markdown_table(header, rows)


CAMPAIGN_TABLES: Mapping[str, Callable[[Committed], str]] = {
    "table.outdoor": outdoor_table,
    "table.reliability": reliability_table,
    **PHYSICAL_TABLES,
}
