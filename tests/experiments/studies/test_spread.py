"""The spread over windows on a user's recordings: tables of made-up runs, and a synthetic pair."""

import numpy as np
import pandas as pd
import pytest

from experiments.studies import spread
from experiments.studies.spread import HALF_WINDOWS_S, N_MINS, SHOWN, spread_figure, spread_table
from ssac.config import N_MIN, Config
from ssac.files.event_files import load_events
from tests.experiments.command import run
from tests.experiments.reported import record_flight
from tests.ssac.bags import arrays, write_bag


def made_up() -> pd.DataFrame:
    """Return four estimates of one method; two of t_d alone, and a refusal, of another."""
    pose = {"r_x_deg": 0.0, "r_y_deg": 0.0, "r_std_deg": 0.5, "t_std_deg": 0.2, "t_x": 0.0}
    rows = [
        {"half_window_s": 0.02, "n_min": n, "method": "joint", "status": "ok", "t_d_ms": 50.0 + d,
         "t_d_std_ms": 0.1, "r_z_deg": 90.0 + 2 * d, **pose,
         "t_y": np.sin(np.deg2rad(d)), "t_z": np.cos(np.deg2rad(d))}
        for n, d in enumerate((-0.3, -0.1, 0.1, 0.3))
    ]  # fmt: skip
    rows += [{"half_window_s": 0.02, "n_min": n, "method": "ssac", "status": status, "t_d_ms": 1.0}
             for n, status in enumerate(("ok", "ok", "no_match"))]  # fmt: skip
    return pd.DataFrame(rows)


def test_the_spread_is_that_of_the_answers_beside_what_they_state():
    table = spread_table(made_up()).set_index(["method", "quantity"])
    rms = np.sqrt(np.mean(np.square([0.3, 0.1, 0.1, 0.3])))
    of = (("t_d_ms", 1.0, 0.1), ("R_deg", 2.0, 0.5), ("t_deg", 1.0, 0.2))
    for quantity, factor, stated in of:
        row = table.loc[("joint", quantity)]
        assert (row["windows"], row["answered"], row["stated"]) == (4, 4, stated)
        # The mean direction is not normalised here, which does not matter for angles this small.
        expected = factor * rms, factor * 0.3, factor * rms / stated
        found = tuple(row[["spread", "most", "spread_over_stated"]])
        assert found == pytest.approx(expected, rel=1e-6)
    assert table.loc[("joint", "t_d_ms"), "median"] == 50.0
    alone = table.loc["ssac", ["windows", "answered", "spread"]]
    assert list(alone.index) == ["t_d_ms"]  # it gives no pose
    assert list(alone.iloc[0]) == [3, 2, 0.0]


def test_a_method_that_never_answers_is_a_row_and_a_figure():
    runs = made_up().assign(status="no_match")
    table = spread_table(runs)
    assert list(table["answered"]) == [0, 0]
    assert table[["spread", "most"]].isna().all(axis=None)
    assert len(spread_figure(runs).axes) == 2
    assert Config().half_window_s in HALF_WINDOWS_S
    assert N_MIN in N_MINS


def test_the_command_takes_ones_own_recordings(tmp_path, monkeypatch):
    monkeypatch.setattr(spread, "HALF_WINDOWS_S", HALF_WINDOWS_S[1:3])  # to be done sooner
    monkeypatch.setattr(spread, "N_MINS", N_MINS[1:2])
    record_flight(tmp_path / "mine", 4.0)
    files = [tmp_path / "mine" / name for name in ("cam1.h5", "cam2.h5", "rig.yaml")]
    folders = ("--out", tmp_path / "out", "--cache", tmp_path / "cache")
    run("study", "spread", *files, *folders, "--workers", 1)
    (study,) = spread.STUDIES
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {*study.files, *study.provenances}
    runs = pd.read_csv(tmp_path / "out" / "spread_runs.csv")
    assert len(runs) == 2 * len(SHOWN)
    table = pd.read_csv(tmp_path / "out" / "spread.csv")
    of_t_d = table[table["quantity"] == "t_d_ms"].set_index("method")
    # The true offset of this pair is 0; 4 s leave an error of a few ms at most.
    assert (of_t_d["median"].abs() < 10.0).all()
    events = {f"/{path.stem}": arrays(load_events(path).events) for path in files[:2]}
    bag = write_bag(tmp_path / "bag", events)
    (bag / "notes").mkdir()
    run("study", "spread", bag / "cam1", bag / "cam2", files[2], *folders, "--workers", 1)
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "out" / "spread_runs.csv"), runs)
