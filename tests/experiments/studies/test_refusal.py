"""The study of refusals: the table, and which flights it draws."""

import pandas as pd
import pytest

from experiments.measures.refusal import RefusalRow
from experiments.studies.refusal import METHOD_NAMES, N_FLIGHTS, refusal_cells, refusal_table


def test_the_table_counts():
    said = [
        RefusalRow("ambiguous_offset", error_sigmas=900.0, t_d_error_ms=900.0),
        RefusalRow("ok", offset_given=True, pose_given=True, error_sigmas=1.0, t_d_error_ms=1.0),
        RefusalRow("ok", offset_given=True, pose_given=True, error_sigmas=100.0,
                   t_d_error_ms=100.0, confident_wrong=True),
    ]  # fmt: skip
    rows = [{"kind": "circle", "method": "joint", **vars(row)} for row in said]
    (row,) = refusal_table(pd.DataFrame(rows)).to_dict("records")
    assert row["runs"] == 3
    assert row["offset_given"] == 2
    assert row["pose_given"] == 2
    assert row["statuses"] == "ok:2 ambiguous_offset:1"
    assert row["error_sigmas_worst"] == pytest.approx(100.0)
    assert row["confident_wrong"] == 1


def test_every_flight_is_drawn_once_and_every_kind_is_run_by_every_method():
    cells = refusal_cells()
    flights = {cell.seed: cell.flight for cell in cells}
    assert len(flights) == len(set(flights.values())) == 10 * N_FLIGHTS
    assert not set(flights) & {cell.other_seed for cell in cells}
    assert min(flights.values()) == 1000
    counts = pd.DataFrame([cell.columns for cell in cells]).groupby(["kind", "method"]).size()
    assert len(counts) == 17 * len(METHOD_NAMES)
    assert (counts == N_FLIGHTS).all()
