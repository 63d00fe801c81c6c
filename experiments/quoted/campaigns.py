"""Results of campaigns in, the tables that the pages show out as Markdown, each under a name."""

from collections.abc import Callable, Mapping

from experiments.lab.markdown import markdown_table
from experiments.lab.results import Results


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
    "table.reliability": reliability_table,
}
