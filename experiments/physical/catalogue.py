"""The studies of the twin."""

from experiments.physical.budget import budget_study
from experiments.physical.latency import latency_study
from experiments.physical.mini import MINI

STUDIES = (*MINI.values(), budget_study(), latency_study())
