"""All studies. Each is a file here that ends with the list `STUDIES`, and one line of FILES."""

from collections.abc import Mapping
from functools import cache
from importlib import import_module

from experiments.lab.study import Study

FILES = (
    "tables",
    "coverage",
    "efficiency",
    "refusal",
    "imperfect",
    "requirements",
    "tangency",
    "fidelity",
    "ablations",
    "spread",
    "by_hand",
    "physical",
    "outdoor",
    "network",
    "real",
    "figures",
    "bench",
)
"""Modules of studies, in the order in which these are listed and checked."""


@cache
def all_studies() -> Mapping[str, Study]:
    """Give every study by name."""
    modules = (import_module(f"experiments.studies.{file}") for file in FILES)
    return {study.name: study for module in modules for study in module.STUDIES}
