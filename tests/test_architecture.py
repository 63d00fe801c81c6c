"""Tests that each import contract of pyproject.toml finds the imports that it forbids."""

from copy import deepcopy
from pathlib import Path

import grimp
import pytest
from importlinter.api import read_configuration
from importlinter.contracts.acyclic_siblings import AcyclicSiblingsContract
from importlinter.contracts.forbidden import ForbiddenContract
from importlinter.contracts.layers import LayersContract
from importlinter.contracts.protected import ProtectedContract

ROOT = Path(__file__).resolve().parents[1]
CONFIGURATION = read_configuration(str(ROOT / "pyproject.toml"))
SESSION = CONFIGURATION["session_options"]
TYPES = {
    "acyclic_siblings": AcyclicSiblingsContract,
    "forbidden": ForbiddenContract,
    "layers": LayersContract,
    "protected": ProtectedContract,
}

PACKAGES = "sim and ssac know nothing of each other, nor of experiments"
SHOWN = "What a package shows to others is not for itself"
OPENGL = "Only sim.render opens OpenGL"

FLOORS = {
    options["containers"][0]: [floor.strip("()") for floor in reversed(options["layers"])]
    for options in CONFIGURATION["contracts_options"]
    if "containers" in options
}
"""Folders and files of each package, in the order in which data flow through them."""


def module_files():
    """Return every module of the three packages by its dotted name, `__init__` included."""
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts): path
        for package in FLOORS
        for path in sorted((ROOT / package).rglob("*.py"))
    }


@pytest.fixture(scope="module")
def imports():
    return grimp.build_graph(
        *SESSION["root_packages"], include_external_packages=True, cache_dir=None
    )


def broken(imports, *added):
    """Return the names of the contracts that are broken when (importer, imported) are added."""
    changed, names = deepcopy(imports), []
    for importer, imported in added:
        changed.add_import(importer=importer, imported=imported)
    for options in CONFIGURATION["contracts_options"]:
        contract = TYPES[options["type"]](options["name"], SESSION, options)
        if not contract.check(deepcopy(changed), verbose=False).kept:
            names.append(options["name"])
    return names


def test_folders_are_two_levels(imports):
    assert not [name for name in imports.modules if name.count(".") > 2]


@pytest.mark.parametrize(
    ("importer", "imported", "contract"),
    [
        ("sim.sensor", "ssac", PACKAGES),
        ("sim.sensor", "experiments", PACKAGES),
        ("ssac.track", "sim.scene", PACKAGES),
        ("ssac.pipeline.api", "experiments.studies", PACKAGES),
        ("sim.sensor", "pyrender", OPENGL),
        ("experiments.studies", "OpenGL", OPENGL),
        ("sim.scene", "sim.render", "Data flow one way through sim"),
        ("ssac.methods", "ssac.pipeline.registry", "Data flow one way through ssac"),
        ("ssac.events", "ssac.files", "Data flow one way through ssac"),
        ("experiments.paper", "experiments.studies", "Data flow one way through experiments"),
        ("sim.scene", "sim", SHOWN),
        ("ssac.estimate", "ssac", SHOWN),
        *((f"{one}.new", "numpy", f"Data flow one way through {one}") for one in FLOORS),
    ],
)
def test_a_wrong_import_and_a_new_folder_without_a_place_are_found(
    imports, importer, imported, contract
):
    assert contract in broken(imports, (importer, imported))


def test_a_circle_within_a_folder_is_found(imports):
    """Only this contract breaks, as all contracts are kept without the circle."""
    one, other = "ssac.track.one", "ssac.track.other"
    found = broken(imports, (one, other), (other, one))
    assert found == ["No circles between the modules of a folder"]
