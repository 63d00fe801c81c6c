from pathlib import Path

import pytest
from hypothesis import settings

from tests.recorded import Recorded, record

settings.register_profile("few", max_examples=8, derandomize=True, deadline=None)
settings.register_profile("fuzz", max_examples=1000, deadline=20_000, print_blob=True)  # [ms]
settings.load_profile("few")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run this folder's own files first: they are longest, and would else end on one worker."""
    items.sort(key=lambda item: item.path.parent != Path(__file__).parent)


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return record(tmp_path_factory.mktemp("recorded"))
