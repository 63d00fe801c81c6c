"""Tables of the bench's twin, of results that are written down here."""

from pathlib import Path

import pandas as pd

from experiments.lab.results import Results
from experiments.physical.budget import METHOD_NAMES
from experiments.quoted.physical import PHYSICAL_TABLES

ERRORS = ("t_d_error_ms", "r_error_deg", "t_error_deg")


def cells_of(table: str, line: int) -> list[str]:
    return [cell.strip() for cell in table.splitlines()[line].strip("|").split("|")]


def test_tables_beside_the_papers_have_its_means_ours_and_the_verdicts(tmp_path: Path) -> None:
    comparison = [
        {"duration_s": duration_s, "angle_deg": 43.14, "t_d_ms": t_d_ms,
         "quantity": f"ssac_{error}", "published_mean": published, "verdict": verdict,
         "paper_size_or_better": "yes"}
        for duration_s in (10.0, 20.0)
        for error in ERRORS
        for t_d_ms, published, verdict in ((5, 1.0, "agrees"), (50, 2.0, "differs"))
    ]  # fmt: skip
    pd.DataFrame(comparison).to_csv(tmp_path / "mini_comparison.csv", index=False)
    means = {"ssac": (0.5, 0.6, 0.7), "joint": (0.3, 0.4, 0.5), "tangency": (0.1, 0.3, 0.4)}
    row = {
        f"{method}_{error}_mean": mean
        for method, of_method in means.items()
        for error, mean in zip(ERRORS, of_method, strict=True)
    }
    for duration_s in (10, 20):
        table = pd.DataFrame([{"angle_deg": 43.14, "t_d_ms": t_d, **row} for t_d in (5, 50)])
        table.to_csv(tmp_path / f"mini_{duration_s}.csv", index=False)
    results = Results(tmp_path)
    expected = ["10", "43.14", "1.5 / 1.5 / 1.5", "0.50 / 0.60 / 0.70", "0.30 / 0.40 / 0.50",
                "0.10 / 0.30 / 0.40"]  # fmt: skip
    assert cells_of(PHYSICAL_TABLES["table.mini"](results), 2) == expected
    verdicts = PHYSICAL_TABLES["table.mini.verdicts"](results)
    # Symbol, duration, cells, agree, better, differ, of its size; then where tangency errs by half.
    assert cells_of(verdicts, 2) == ["t_d", "10", "2", "1", "0", "1", "2", "2"]
    assert cells_of(verdicts, 6) == ["t", "10", "2", "1", "0", "1", "2", "0"]


def test_intervals_are_counted_once_for_each_recording_that_was_answered(tmp_path: Path) -> None:
    runs = pd.DataFrame(
        [
            {"t_d_ms": t_d_ms, "method": method, "status": status, "t_d_error_ms": error_ms,
             "t_d_std_ms": 1.0}
            for t_d_ms in (5.0, 50.0)
            for method in METHOD_NAMES
            for status, error_ms in (("ok", 1.0), ("ok", 3.0), ("ambiguous_offset", None))
        ]
    )  # fmt: skip
    for duration_s in (10, 20):
        runs.to_csv(tmp_path / f"mini_{duration_s}_runs.csv", index=False)
    table = PHYSICAL_TABLES["table.mini.held"](Results(tmp_path))
    assert cells_of(table, 2) == ["10", "`joint`", "2 of 3", "50", "2.0", "1.0"]
    assert len(table.splitlines()) == 2 + 4


def test_the_budget_has_what_each_adds_alone_and_what_its_lack_spares(tmp_path: Path) -> None:
    kinds = {"none": 0.1, "only light": 0.2, "all but light": 0.8, "all": 1.0}
    rows = [
        {"kind": kind, "angle_deg": angle_deg, "method": method,
         **{f"{error}_mean": factor * value for error in ERRORS}}
        for kind, value in kinds.items()
        for angle_deg, factor in ((43.14, 1.0), (65.06, 3.0))
        for method in METHOD_NAMES
    ]  # fmt: skip
    pd.DataFrame(rows).to_csv(tmp_path / "error_budget.csv", index=False)
    results = Results(tmp_path)
    table = PHYSICAL_TABLES["table.budget.R"](results)
    assert cells_of(table, 2) == ["nothing", *["0.20", "2.0"] * 3]  # means of both angles
    assert cells_of(table, 3) == ["light", *["0.40", "1.6"] * 3]
    by_angle = PHYSICAL_TABLES["table.budget.angles"](results)
    assert cells_of(by_angle, 2) == ["43.14", "none", *["0.10 / 0.10 / 0.10"] * 3]
    assert cells_of(by_angle, 5) == ["65.06", "all", *["3.0 / 3.0 / 3.0"] * 3]


def test_a_ratio_of_lights_shows_its_offsets_by_polarity(tmp_path: Path) -> None:
    pd.DataFrame(
        [
            {"light_ratio": ratio, "polarity": polarity, "runs": 5, "answered": 4,
             "apparent_ms_mean": offset_ms, "t_d_std_ms": 0.05, "swapped_ms": 0.01}
            for ratio in (2.0, 0.5)
            for polarity, offset_ms in (("both", 0.3), ("on", 0.2), ("off", 0.4))
        ]
    ).to_csv(tmp_path / "light_latency.csv", index=False)  # fmt: skip
    table = PHYSICAL_TABLES["table.latency"](Results(tmp_path))
    assert cells_of(table, 2) == ["0.5", "0.30", "0.20", "0.40", "0.050", "0.01", "4 of 5"]
