from pathlib import Path

import pytest

from tests.experiments.lab.squares import write_squares
from tests.experiments.reported import record_flight


@pytest.fixture(scope="session")
def flight_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 10 s, which no test may change."""
    folder = tmp_path_factory.mktemp("flight")
    record_flight(folder)
    return folder


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """The files of `ssac study squares`, which a test may damage."""
    write_squares(tmp_path / "results")
    return tmp_path / "results"
