import pytest

from tests.recorded import Recorded, record


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest file: at the end, other workers would wait for the one that has it."""
    items.sort(key=lambda item: item.path.name != "test_one_answer.py")


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return record(tmp_path_factory.mktemp("recorded"))
