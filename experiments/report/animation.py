"""A flight whose camera 2 is set ahead by a known offset, for the page's player.

The offset and F are estimated as for any recording; the truth is for the words beside it.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.lab.score import Score, score
from sim.errors import SimError
from ssac.estimate import Estimate
from ssac.pipeline.api import chain_of
from ssac.pipeline.html_report import player_of, seen_by
from ssac.pipeline.plots import d_avg_px, material_of

METHOD = "tangency"
T_D_S = 0.5  # large enough that both views are plainly apart


@dataclass(frozen=True)
class Animation:
    """What the player draws, and the estimate behind it."""

    estimate: Estimate
    errors: Score
    before_px: float  # d_avg with the clocks as recorded
    after_px: float  # and with the offset found
    player: dict[str, Any]


def make_animation(folder: Path) -> Animation:
    """Estimate the offset of a recording with t_d = 0 whose camera 2 is set T_D_S ahead."""
    files = folder / "cam1.h5", folder / "cam2.h5"
    answer = chain_of(files, folder / "rig.yaml").delayed(T_D_S).answer(METHOD)
    estimate = answer.estimate
    if estimate.status != "ok":
        raise SimError(
            f"{folder}: expected a recording that {METHOD} can synchronise, got {estimate.status} "
            f"({estimate.reason}): simulate one of 20 s at 90 deg"
        )
    answers, material = {(0, 1): answer}, material_of(answer)
    materials = {(0, 1): material}
    player = player_of(answers, materials, seen_by(answers, materials), tour=True)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    errors = score(estimate, T_D_S, np.array(truth["R"]), np.array(truth["t"]))
    before_px, after_px = d_avg_px(material, np.array([0.0, estimate.t_d_s])).tolist()
    return Animation(estimate, errors, before_px, after_px, player)
