"""Tables of campaigns from made-up results."""

import pandas as pd

from experiments.lab.results import Results
from experiments.network.four import camera_cells, camera_table
from experiments.network.long_flights import COLUMNS
from experiments.network.measure import CameraRow
from experiments.quoted.campaigns import CAMPAIGN_TABLES


def test_campaigns_that_were_not_run_leave_no_table(tmp_path) -> None:
    for table in CAMPAIGN_TABLES.values():
        assert table(Results(tmp_path)) == ""


def test_outdoors_is_counted_what_held(tmp_path) -> None:
    row = dict.fromkeys(
        ("t_d_error_ms", "t_d_std_ms", "skew_error_ppm", "skew_std_ppm", "r_error_deg",
         "t_error_deg", "rmse_m", "icp_rmse_m", "scale_error_percent", "coverage"), 1.0,
    )  # fmt: skip
    rows = [row, row | {"t_d_error_ms": 3.0, "rmse_m": 2.0}, row | {"rmse_m": None}]
    pd.DataFrame([{"kind": "as_recorded"} | each for each in rows]).to_csv(
        tmp_path / "outdoor.csv", index=False
    )
    line = CAMPAIGN_TABLES["table.outdoor"](Results(tmp_path)).splitlines()[-1]
    cells = [cell.strip() for cell in line.split("|")]
    assert cells[1:4] == ["as recorded", "2 of 3", "2.000"]
    assert "1, 2" in cells  # 3 ms are no 1.96 deviations of 1 ms
    assert "1.500 (2.000)" in cells


def test_four_cameras_are_told_with_the_largest_errors_and_what_held(tmp_path) -> None:
    rows = []
    for cell in camera_cells(2):
        path = {"path_rmse_mm": 4.0 + cell.flight, "path_held": 0.9} if cell.camera == 1 else {}
        pose = {} if path else {"t_d_error_ms": 0.1 * cell.camera, "t_d_normalised": 1.0}
        rows.append({**cell.columns, **vars(CameraRow("ok", **path, **pose))})
    camera_table(pd.DataFrame(rows)).to_csv(tmp_path / "network.csv", index=False)
    lines = CAMPAIGN_TABLES["table.network"](Results(tmp_path)).strip().splitlines()
    assert len(lines) == 4
    assert "as recorded" in lines[2]
    assert "0.300 (0.400)" in lines[2]  # of 0.2, 0.3 and 0.4 ms
    assert "held of 6" in lines[0]
    assert "6, 0, 0, 0" in lines[2]  # regions that are not stated hold nothing
    assert "4.5 (5.0)" in lines[2]
    assert lines[2].rstrip(" |").endswith("90")


def test_growth_has_a_line_for_each_flight(tmp_path) -> None:
    values = [150.0, 8, 72000, 60.4, 59.0, 40.0, 20.0, 445.0, "ok", 0.2058, 0.003583]
    table = pd.DataFrame([values, [300.0, *values[1:]]], columns=COLUMNS)
    table.to_csv(tmp_path / "network_growth.csv", index=False)
    lines = CAMPAIGN_TABLES["table.network.growth"](Results(tmp_path)).strip().splitlines()
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines[2:]]
    rest = ["72000", "60", "59", "40", "20", "445", "0.21", "0.0036"]
    assert cells == [["150", *rest], ["300", *rest]]
