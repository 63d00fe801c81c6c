"""Grids: what a TOML may hold, and the cells that it stands for."""

from itertools import product
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.lab.cache import Cache, content
from experiments.lab.grid import configs_of, flight_seed, grid_from_content, named_config
from experiments.lab.schedule import Workers, run_cells
from sim.errors import SimError
from sim.recording import SimConfig
from ssac.config import Config
from ssac.errors import SsacError
from ssac.files.hdf5 import load_events_h5
from ssac.pipeline.registry import METHODS
from ssac.track.observation import Observation
from tests.experiments.command import run

SMALL = {
    "flights": 2,
    "methods": ["ssac", "zncc_e"],
    "search_around_truth_s": [-1.0, 1.0],
    "fixed": {"sim": {"spline": {"duration_s": 10}}},
    "grid": {"sim": {"angle_deg": [30, 90], "t_d_s": [0.005, 0.5]}},
}


def test_the_tables_are_the_papers_grid():
    cells = [cell for name in ("esim_10", "esim_20") for cell in named_config(name).cells()]
    at = product((10.0, 20.0), (30.0, 60.0, 90.0, 120.0, 150.0), (0.005, 0.05, 0.5), range(30))
    assert sorted(
        (cell.sim.spline.duration_s, cell.sim.angle_deg, cell.t_d_s, cell.flight, cell.method)
        for cell in cells
    ) == sorted((*where, method) for where in at for method in METHODS)
    # There are 300 recordings: all offsets and methods share one.
    assert len({(cell.sim, cell.seed) for cell in cells}) == 300
    for cell in cells:
        low, high = cell.estimator.interval_s
        assert (cell.t_d_s - low, high - cell.t_d_s) == pytest.approx((1.0, 1.0), abs=1e-12)


def test_a_seed_is_a_fixed_hash_of_duration_angle_and_flight():
    # These are seeds of committed recordings: another hash would mean other flights.
    assert flight_seed(10.0, 30.0, 0) == 1328313481
    assert flight_seed(20, 150, 9) == flight_seed(20.0, 150.0, 9) == 1883054829
    assert flight_seed(10.0, 30.0, 0, base_seed=1) != flight_seed(10.0, 30.0, 0)


def test_cells_of_one_recording_differ_in_nothing_that_is_simulated():
    """So offsets, methods and values of a parameter are compared on the same flights."""
    cells = grid_from_content("small", SMALL).cells()
    assert len(cells) == 2 * 2 * 2 * 2
    assert len({cell.sim for cell in cells}) == 2  # of two angles
    first = cells[0]
    assert (first.method, first.flight, first.t_d_s) == ("ssac", 0, 0.005)
    parameters = {"sim.spline.duration_s": 10, "sim.angle_deg": 30, "sim.t_d_s": 0.005}
    assert first.parameters == parameters
    assert first.estimator.interval_s == (-0.995, 1.005)
    # Parameters that move together are one axis.
    together = {"together": {"c": {"ssac": {"n_min": [1, 2]}, "sim": {"focal_px": [100, 200]}}}}
    grid = grid_from_content("small", SMALL | together)
    cells = grid.cells()
    pairs = {(cell.sim.focal_px, cell.estimator.n_min) for cell in cells}
    assert pairs == {(100.0, 1), (200.0, 2)}
    assert grid.varied == ("sim.angle_deg", "sim.t_d_s", "ssac.n_min", "sim.focal_px")
    flown = {(cell.sim.angle_deg, cell.flight, cell.seed) for cell in cells}
    assert flown == {(*at, flight_seed(10.0, *at)) for at in product((30.0, 90.0), (0, 1))}


@pytest.mark.render
def test_a_row_is_of_the_recording_that_ssac_simulate_makes_of_its_columns(tmp_path):
    content = {"fixed": {"sim": {"spline": {"duration_s": 1.0}, "angle_deg": 60, "t_d_s": 0.005}}}
    few = {"flights": 1, "methods": ["event_rate"]}
    (cell,) = grid_from_content("short", content | few).cells()
    cache, out = Cache(tmp_path / "cache"), tmp_path / "out"
    row = run_cells([cell], cache, Workers(1), show_progress=False).runs.iloc[0]
    at, lasts, late = row[["sim.angle_deg", "sim.spline.duration_s", "sim.t_d_s"]]
    options = ("--angle", at, "--duration", lasts, "--t-d", late, "--seed", row["seed"])
    run("simulate", out, *options)
    kept = cache.recording_folder(cell.sim, cell.seed)
    for name, t_d_s in (("cam1.h5", 0.0), ("cam2.h5", late)):
        simulated, cached = (load_events_h5(folder / name).events for folder in (out, kept))
        assert len(cached) > 1000
        assert np.array_equal(simulated, Observation(cached).delayed(t_d_s).events)


def test_a_file_of_the_project_is_found_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    files = {file for cell in named_config("ablation_background").cells()
             for file in cell.sim.background_files}  # fmt: skip
    assert {file.stem for file in files} == {"clouds", "houses", "leaves"}
    assert all(file.is_file() for file in files)
    assert len({content(file) for file in files}) == 3  # part of a recording's key


def test_parameters_reach_the_field_that_they_name():
    values = {
        "sim.render.lattice.a": (4, 4),
        "sim.resolution": ([640, 480], (640, 480)),
        "sim.focal_px": (400, 400.0),
        "sim.drone_size_m": (1, 1.0),
        "sim.drone_file": ("bird.ply", Path("bird.ply")),
        "sim.distortion_coeffs": ([0.1, 0.2, 0, 0], (0.1, 0.2, 0.0, 0.0)),
        "ssac.n_min": (50, 50),
        "ssac.exhaustive": (True, True),
        "ssac.interval_s": ([-2, 2.5], (-2.0, 2.5)),
    }
    sim, ssac = configs_of({name: given for name, (given, _) in values.items()})
    for name, (_, expected) in values.items():
        found = attrgetter(name)(SimpleNamespace(sim=sim, ssac=ssac))
        assert repr(found) == repr(expected), name  # the types are equal, too
    assert configs_of({}) == (SimConfig(), Config())


@pytest.mark.parametrize(
    "values",
    [
        {"sim.frames.exposure_s": 0.03, "sim.frames.rate_hz": 25.0},  # 50 Hz has room for 0.02 s
        {"sim.effects.frame_gap_s": 0.03, "sim.frames.rate_hz": 25.0},
        {"sim.effects.cutoff_min_hz": 6000.0, "sim.effects.cutoff_max_hz": 1e4},
        {"sim.spline.duration_s": 0.3, "sim.spline.sampling_hz": 20.0},
    ],
)
def test_parameters_are_checked_together_whatever_their_order(values):
    sim, _ = configs_of(values)
    assert configs_of(dict(reversed(values.items()))) == (sim, Config())
    assert all(attrgetter(name)(SimpleNamespace(sim=sim)) == values[name] for name in values)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"trajectory": 3}, r"unknown key 'trajectory': known are title, flights"),
        ({"flights": 0}, "flights must be a positive integer, got 0"),
        ({"first_flight": -1}, "first_flight must be 0 or a positive integer, got -1"),
        ({"flights": True}, "flights must be a positive integer, got True"),
        ({"flights": 4_294_967_296}, r"the grid has .* runs, and 1000000 are the most"),
        ({"methods": ["scac"]}, "unknown method 'scac': use one of"),
        ({"methods": 3}, "methods must be a list of names, got 3"),
        ({"methods": [3]}, r"methods must be a list of names, got \[3\]"),
        ({"methods": ["ssac", "ssac"]}, "methods: 'ssac' is given more than once"),
        ({"grid": {"sim": {"angle_deg": [30, 9, 30.0]}}}, r"sim.angle_deg: \[30.0\] is given more"),
        ({"grid": {"sim": {"t_d_s": [1000.001, 1000.004]}}},
         r"sim.t_d_s: \[1000.004\] is given more than once, to the 6 digits of a table"),
        ({"title": 3}, "title must be a text, got 3"),
        ({"together": 3}, "together must be a table of tables, got 3"),
        ({"fixed": 3}, "fixed, grid and together must be tables"),
        ({"search_around_truth_s": [1.0]}, "search_around_truth_s: expected two numbers"),
        ({"fixed": {"sim": {"angel_deg": 3}}}, r"'sim.angel_deg': 'angel_deg' is none of angle"),
        ({"fixed": {"sim": {"angle_deg": {"x": 3}}}}, "'sim.angle_deg.x': 'angle_deg' has no"),
        ({"fixed": {"simulator": {"x": 3}}}, r"expected sim.<name> or ssac.<name>"),
        ({"fixed": {"ssac": {"n_min": 2.5}}}, "ssac.n_min: expected int, got 2.5"),
        ({"fixed": {"ssac": {"n_min": True}}}, "ssac.n_min: expected int, got True"),
        ({"fixed": {"sim": {"resolution": [3]}}}, r"sim.resolution: expected tuple\[int, int\]"),
        ({"grid": {"sim": {"angle_deg": [30, 500]}}}, "angle .* 180"),
        ({"fixed": {"sim": {"angle_deg": 30}}}, "sim.angle_deg is given more than once"),
        ({"fixed": {"ssac": {"interval_s": [0, 1]}}}, "either search_around_truth_s or ssac.int"),
        ({"fixed": {"ssac": {"half_window_s": -1.0}}}, "must be positive and finite, got -1.0"),
        ({"grid": {"ssac": {"n_min": []}}}, "ssac.n_min: expected a list of values"),
        ({"grid": {"ssac": {"n_min": 3}}}, "ssac.n_min: expected a list of values, got 3"),
        ({"together": {"c": {"sim": {"focal_px": [1, 2], "resolution": [[3, 4]]}}}},
         "together.c: expected lists of one length, but sim.focal_px has 2, sim.resolution"),
        ({"fixed": {"sim": {"trajectory_file": "a.csv"}}}, "flights must be 1 where sim.traject"),
        ({"fixed": {"sim": {"trajectory_file": "a.csv", "effects": {"blur_px": 1}}}}, "must be 1"),
        ({"figure": {"x": "ssac.n_min", "label": ""}}, "'ssac.n_min' is not a parameter that the"),
        ({"figure": {"x": "sim.t_d_s", "label": 3}}, "figure: expected a table with x, label, sc"),
        ({"grid": {"sim": {"drone": ["bird"]}}, "figure": {"x": "sim.drone", "label": ""}},
         "figure: x = 'sim.drone' has values that are no numbers"),
        ({"figure": {"y": "ssac.n_min"}}, "figure: expected a table with x, label, scale, log"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_an_error_that_says_so(change, message):
    with pytest.raises((SimError, SsacError), match=message):
        grid_from_content("small", SMALL | change)


@pytest.mark.parametrize(
    ("flights", "noise"),
    [
        (1, {}),
        (2, {"sensor": {"threshold_mismatch": 0.03}}),
        (2, {"sensor": {"leak_hz": 0.1}}),
        (2, {"effects": {"jitter_s": 1e-5}}),
    ],
)
def test_flights_along_a_given_path_may_differ_by_noise_alone(flights, noise):
    change = {"fixed": {"sim": {"trajectory_file": "a.csv"} | noise}, "flights": flights}
    assert grid_from_content("small", SMALL | change).flights == flights
