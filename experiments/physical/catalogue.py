"""The studies of the twin."""

from collections.abc import Mapping

from experiments.lab.study import Study
from experiments.physical.budget import budget_study
from experiments.physical.latency import latency_study
from experiments.physical.mini import MINI

PHYSICAL_STUDIES: Mapping[str, Study] = {
    study.name: study for study in (*MINI.values(), budget_study(), latency_study())
}
"""By name."""
