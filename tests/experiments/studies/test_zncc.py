"""The study of ZNCC: what becomes of its runs, and which flights it draws."""

import pandas as pd

from experiments.measures.zncc import MODELLED, RENDERED
from experiments.studies.zncc import DEFAULT, FIRST_FLIGHT, N_MORE, signal_cells, signal_means


def test_means_count_the_gross_errors():
    key = {"source": "s", "scene": "c", "duration_s": 1.0, "signal": "e", "angle_deg": 30.0}
    rows = [{**key, "error_ms": error, "at_truth": 0.5} for error in (0.0, 20.0, 400.0, 100.0)]
    rows += [{**key, "error_ms": 900.0, "at_truth": 0.0, "status": "crashed"}]
    rows += [{**key, "angle_deg": 60.0, "error_ms": 7.0, "at_truth": 0.1}]
    runs = pd.DataFrame(rows).fillna({"status": "ok"}).assign(cell=1, flight=3, seed=4, reason="")
    (row,) = signal_means(runs).iloc[:1].to_dict("records")
    assert (row["flights"], row["error_ms_mean"], row["gross_share"]) == (4, 130.0, 0.25)
    assert row["at_truth"] == 0.5
    assert not {"cell", "flight", "seed"} & set(row)


def test_scenes_share_flights_and_no_flight_is_the_tables():
    cells = signal_cells()
    assert min(cell.flight for cell in cells) == FIRST_FLIGHT
    rendered = [cell for cell in cells if cell.source == RENDERED]
    at_90 = [{c.seed for c in rendered if c.scene == scene and c.sim.angle_deg == 90.0}
             for scene in (DEFAULT, "no turning")]  # fmt: skip
    assert at_90[1] < at_90[0]
    assert len(at_90[0]) == N_MORE[DEFAULT, 90.0]
    assert {cell.source for cell in cells} == {RENDERED, MODELLED}
