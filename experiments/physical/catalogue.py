"""A folder of results in; the studies of the twin of which it holds a file out."""

from collections.abc import Mapping
from pathlib import Path

from experiments.physical.budget import budget_study
from experiments.physical.latency import latency_study
from experiments.physical.mini import MINI
from experiments.studies.study import Study

PHYSICAL_STUDIES: Mapping[str, Study] = {
    study.name: study for study in (*MINI.values(), budget_study(), latency_study())
}
"""By name; a folder of results may lack each, or has all its files."""


def physical_in(results: Path) -> Mapping[str, Study]:
    """Leave out the studies of which a folder holds no file."""
    return {
        name: study
        for name, study in PHYSICAL_STUDIES.items()
        if any(
            (results / file).is_file()
            for file in (study.runs_file, study.summary_file, study.figure_file)
        )
    }
