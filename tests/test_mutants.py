"""Tests that the list of mutants fits the code; `.ci/mutants` runs the tests that kill them."""

import pytest

from tests.mutants import ROOT, mutants

MUTANTS = mutants()


@pytest.mark.parametrize("mutant", MUTANTS, ids=[one.name for one in MUTANTS])
def test_a_mutant_can_be_made_and_has_tests(mutant):
    compile(mutant.mutated(ROOT), mutant.file, "exec")
    assert mutant.old != mutant.new
    places = [one for one in mutant.arguments(ROOT) if one.startswith("tests/")]
    assert {(ROOT / one).exists() for one in places} == {True}


def test_there_are_sixty_of_all_packages():
    assert len({one.name for one in MUTANTS}) == len(MUTANTS) >= 60
    assert {one.file.split("/")[0] for one in MUTANTS} == {"sim", "ssac", "experiments"}
