"""One flight and its animation, for all that shows them: to make it takes some seconds."""

from pathlib import Path

import pytest

from experiments.report.animation import Animation, make_animation
from tests.experiments.reported import record_flight


@pytest.fixture(scope="session")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that nobody changes."""
    folder = tmp_path_factory.mktemp("flight")
    record_flight(folder)
    return folder


@pytest.fixture(scope="session")
def animation(flight: Path) -> Animation:
    return make_animation(flight)
