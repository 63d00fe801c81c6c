"""The marks of real recordings: what is made of a flight, how it is judged, what the pages show."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.lab.again import row_faults
from experiments.lab.cell import CRASHED
from experiments.lab.files import save_csv
from experiments.lab.recorded import Pair
from experiments.lab.results import Results
from experiments.marks.kinds import CLUTTER, FILMED, KINDS, UNSTATED, Kind, Mark
from experiments.marks.measure import Flown, MarkCell, MarkRow, ends_of, marked_pair, marked_row
from experiments.marks.table import FLIGHTS, STUDIES, flights_of, mark_cells, marks_table
from experiments.measures.imperfect_kinds import T_D_S
from experiments.quoted.marks import MARK_NUMBERS, MARK_TABLES
from sim.recording import SimConfig
from ssac.estimate import Estimate
from tests.experiments.synthetic_flight import DURATION_S, SCENE, flown

SEED = 5


def made(kind: Kind, other: Pair | None = None) -> Pair:
    return marked_pair(flown(), other, kind, SEED, DURATION_S)


def test_a_kind_of_nothing_adds_an_offset_and_nothing_else() -> None:
    flight, pair = flown(), made(KINDS["nothing"])
    assert np.array_equal(pair.cam1.events, flight.cam1.events)
    assert np.array_equal(pair.cam2.events, flight.cam2.delayed(T_D_S).events)
    for one, other in ((pair.rig.cam1, flight.rig.cam1), (pair.rig.cam2, flight.rig.cam2)):
        assert np.array_equal(one.K, other.K)
        assert one.intrinsics_std_px == other.intrinsics_std_px
    assert np.array_equal(pair.rig.T_2_1, flight.rig.T_2_1)


def test_a_clock_runs_fast_about_the_middle_and_jumps_once() -> None:
    flight = flown()
    plain_us = flight.cam2.events["t"] + round(1e6 * T_D_S)
    fast = made(Kind("clocks", "20 s", skew_ppm=50.0)).cam2.events["t"] - plain_us
    expected_us = 5e-5 * (flight.cam2.events["t"] - 0.5e6 * DURATION_S)
    assert np.abs(fast - expected_us).max() <= 0.5  # whole microseconds
    stepped = made(Kind("clocks", "20 s", jump=(4.0, 5e-3))).cam2.events["t"] - plain_us
    assert np.array_equal(stepped, np.where(flight.cam2.events["t"] >= 4_000_000, 5_000, 0))


def test_intrinsics_are_off_and_stated_as_a_kind_says() -> None:
    errors = ((0.01, 0.02, 3.0, -2.0), (0.0, 0.0, 0.0, 0.0))
    pair, true = made(Kind("intrinsics", "10 s", errors=errors, stated=(1.0, 3.0))), SCENE.rig
    off_px = pair.rig.cam1.K - true.cam1.K
    assert np.diag(pair.rig.cam1.K) == pytest.approx(np.diag(true.cam1.K) * (1.01, 1.02, 1.0))
    assert off_px[:2, 2] == pytest.approx((3.0, -2.0))
    assert np.array_equal(pair.rig.cam2.K, true.cam2.K)
    focal_px = true.cam2.K[0, 0]
    assert pair.rig.cam2.intrinsics_std_px == pytest.approx(
        (0.01 * focal_px, 0.01 * focal_px, 3, 3)
    )


def test_other_flights_are_one_in_each_camera() -> None:
    other = flown(1)
    pair = made(Kind(CLUTTER, "20 s", others=True), other)
    assert np.array_equal(pair.cam1.events, flown().cam1.events)
    assert np.array_equal(pair.cam2.events, other.cam2.delayed(T_D_S).events)


def test_the_ends_are_where_the_clock_says() -> None:
    """A skew that is 10 ppm too large is 30 us off after 3 s, less where the offset makes up."""
    found = Estimate(
        "tangency", t_d_s=T_D_S + 1e-5, skew_ppm=60.0, t_ref_s=3.0,
        clock_covariance=np.diag([1e-5, 1e-5]) ** 2,
    )  # fmt: skip
    error_ms, sigmas = ends_of(found, 50.0, 3.0)
    assert error_ms == pytest.approx(0.04)
    assert sigmas == pytest.approx(0.04 / (1e-2 * np.sqrt(10.0)))
    assert np.isnan(ends_of(replace(found, status="no_match"), 50.0, 3.0)).all()


def test_a_kind_is_run_and_told_how_far_its_rig_moves_the_estimate() -> None:
    sim = replace(SimConfig(), spline=replace(SimConfig().spline, duration_s=DURATION_S))
    cells = [MarkCell(sim, 0, SEED, kind, SEED + 1) for kind in ("nothing", *list(UNSTATED)[:1])]
    shared = Flown(flown(), None)
    right, wrong = (marked_row(cell, shared) for cell in cells)
    assert (right.status, wrong.status) == ("ok", "ok"), (right.reason, wrong.reason)
    assert right.cpu_s > 0.0
    assert np.isnan(right.r_moved_deg)
    # Both focal lengths 1 % too long turn R by some tenths of a degree, and t_d by next to nothing.
    assert 0.05 < wrong.r_moved_deg < 2.0
    assert wrong.t_d_moved_ms < 3.0 * right.t_d_std_ms
    assert wrong.t_d_error_ms == pytest.approx(right.t_d_error_ms, abs=wrong.t_d_moved_ms + 1e-9)


def test_a_skew_that_is_not_looked_for_has_no_deviation() -> None:
    sim = replace(SimConfig(), spline=replace(SimConfig().spline, duration_s=DURATION_S))
    cell = MarkCell(sim, 0, SEED, "20 s, clocks alike, no skew looked for", SEED + 1)
    row = marked_row(cell, Flown(flown(), None))
    assert row.status == "ok", row.reason
    assert np.isnan(row.skew_normalised)
    assert np.isfinite(row.ends_normalised)


def test_every_kind_is_run_on_the_flights_of_its_scene() -> None:
    table = pd.DataFrame([cell.columns for cell in mark_cells()])
    assert list(dict.fromkeys(table["kind"])) != []
    counts = table.groupby("kind").size()
    for name, kind in KINDS.items():
        assert counts[name] == flights_of(kind) <= FLIGHTS[kind.scene]
    seeds = {cell.seed for cell in mark_cells()}
    assert len(seeds) == sum(FLIGHTS[scene] for scene in FILMED)
    assert not seeds & {cell.other_seed for cell in mark_cells()}


def rows_of(kind: str, *rows: MarkRow) -> list[dict[str, object]]:
    return [{"group": KINDS[kind].group, "kind": kind, **vars(row)} for row in rows]


def runs() -> pd.DataFrame:
    """A row for each kind, with more of some: answers, refusals and a crash."""
    right = MarkRow("ok", "", True, True, t_d_error_ms=0.2, t_d_std_ms=0.1, t_d_normalised=2.0,
                    r_error_deg=0.1, r_mahalanobis=2.7, t_mahalanobis=2.5, cpu_s=1.0)  # fmt: skip
    wrong = replace(right, t_d_error_ms=0.4, t_d_normalised=-3.6, cpu_s=3.0)
    told, crash = MarkRow("several_objects", "two things"), MarkRow(CRASHED, "a bug")
    rows = rows_of("second drone 10 %", right, wrong, told, crash)
    rows += rows_of(
        "20 s, jump of 5 ms", right, MarkRow("clock_jump", "by", jump_ms=4.5, jump_at_s=8.1)
    )
    rows += rows_of("5 px drone, davis346", replace(right, t_d_error_ms=0.09), told)
    rows += [
        row
        for kind in KINDS
        if kind not in {one["kind"] for one in rows}
        for row in rows_of(kind, replace(right, t_d_moved_ms=0.5, skew_error_ppm=1.0))
    ]
    return pd.DataFrame(rows)


def test_the_table_counts_what_reaches_its_mark_and_what_holds() -> None:
    table = marks_table(runs()).set_index("kind")
    assert list(table.index) == list(KINDS)
    row = table.loc["second drone 10 %"]
    assert (row["runs"], row["answered"], row["refused"]) == (4, 2, "crashed:1 several_objects:1")
    assert row["reached"] == 2  # one is near and one is told; a crash says nothing
    assert (row["t_d_error_ms_most"], row["cpu_s_median"], row["cpu_s_most"]) == (0.4, 2.0, 3.0)
    # 1.96 deviations of one number, 2.80 of three together, 2.45 of two hold 95 %.
    assert (row["t_d_given"], row["t_d_held"]) == (2, 0)
    assert (row["r_held"], row["t_held"], row["ends_given"]) == (2, 0, 0)
    assert row["confident_wrong"] == 1
    assert table.loc["20 s, jump of 5 ms", "reached"] == 1
    assert table.loc["5 px drone, davis346", "reached"] == 1  # a refusal is no answer there
    assert np.isnan(table.loc[next(iter(UNSTATED)), "reached"])


def test_the_pages_show_each_kind_beside_its_mark(tmp_path: Path) -> None:
    save_csv(tmp_path / "marks.csv", marks_table(runs()))
    results, shown = Results(tmp_path), []
    for name, table in MARK_TABLES.items():
        header, _, *body = (
            [cell.strip() for cell in line.strip("|").split("|")]
            for line in table(results).splitlines()
        )
        assert len(header) == len(set(header)) or name == "table.marks.clocks"
        shown += [row[0] for row in body]
        if name == "table.marks.clutter":
            (drone,) = [row for row in body if row[0] == "second drone 10 %"]
            assert drone[1:4] == [
                "2, crashed 1 several objects 1", "0.3 ms: 2", "0.400",
            ]  # fmt: skip
    assert len(shown) == len(set(shown)) == len(KINDS)
    assert MARK_NUMBERS["marks.reached.second_drone_10_%"](results) == "2 of 4"
    told = MARK_NUMBERS["marks.jumps.20_s_jump_of_5_ms"](results)
    assert told == "4.5 to 4.5 ms, at 8.1 to 8.1 s"
    assert MARK_NUMBERS["marks.rms.nothing"](results) == "0.200 ms"
    assert MARK_NUMBERS["marks.seconds.second_drone_10_%"](results) == "3.0 s"


@pytest.mark.parametrize("mark", [kind.mark for kind in KINDS.values() if kind.mark])
def test_a_mark_asks_for_something(mark: Mark) -> None:
    assert mark.must_refuse or min(mark.t_d_ms, mark.r_deg, mark.skew_ppm) < np.inf


def test_another_time_is_no_other_run() -> None:
    """What a run took is measured, so that making it again gives another number."""
    committed = pd.DataFrame([{"cell": "0", "status": "ok", "reason": "", "cpu_s": "1.5"}])
    assert (
        row_faults(committed.assign(cpu_s="2.5"), committed, ("cell",), (), STUDIES[0].runs) == ()
    )
    other = row_faults(
        committed.assign(status="no_match"), committed, ("cell",), (), STUDIES[0].runs
    )
    assert len(other) == 1
