"""Every study that comes with the project, by name, in the order in which they are listed."""

from collections.abc import Mapping

from experiments.lab.study import Study
from experiments.marks.kinds import KINDS
from experiments.marks.measure import MARKED, METHOD
from experiments.marks.table import FEW, FIRST_FLIGHT, FLIGHTS, mark_cells, marks_table
from experiments.paper.grids import ANGLES_DEG
from experiments.studies.coverage import coverage_study
from experiments.studies.efficiency import EFFICIENCY
from experiments.studies.fidelity import FIDELITY_STUDY, RENDERERS_STUDY
from experiments.studies.grids import ablation_names, ablation_study
from experiments.studies.imperfect import IMPERFECT
from experiments.studies.refusal import REFUSAL
from experiments.studies.tangency import TANGENCY
from experiments.studies.zncc import ZNCC
from ssac.errors import SsacError

ABLATIONS: Mapping[str, Study] = {name: ablation_study(name) for name in ablation_names()}
"""By the names that `ssac ablate` takes."""

MARKS = Study(
    "marks",
    "Clutter, clocks and intrinsics of real recordings, each kind beside its mark",
    mark_cells,
    MARKED,
    marks_table,
    keys=("kind", "flight"),
    config={"flights": dict(FLIGHTS), "few": FEW, "first_flight": FIRST_FLIGHT,
            "angles_deg": ANGLES_DEG, "kinds": list(KINDS), "method": METHOD},
)  # fmt: skip

STUDIES: Mapping[str, Study] = {
    study.name: study
    for study in (
        EFFICIENCY,
        coverage_study(),
        REFUSAL,
        IMPERFECT,
        MARKS,
        TANGENCY,
        ZNCC,
        FIDELITY_STUDY,
        RENDERERS_STUDY,
        *ABLATIONS.values(),
    )
}


def chosen_studies(names: list[str], known: Mapping[str, Study], kind: str) -> list[Study]:
    """Look studies up; SsacError for a name that is none."""
    unknown = [name for name in names if name not in known]
    if unknown:
        raise SsacError(f"unknown {kind} {unknown[0]!r}: use one of {', '.join(known)}")
    return [known[name] for name in names]
