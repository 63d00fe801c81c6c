import numpy as np
import pandas as pd
import pytest

from experiments.studies.tangency import AS_IT_IS, VARIANTS, study_figure, variant_means
from ssac.methods.tangency import TangencyConfig


def runs() -> pd.DataFrame:
    """Two angles, two variants; one run failed."""
    columns = ("variant", "angle_deg", "status", "t_d_error_ms", "normalised")
    rows = [
        (AS_IT_IS, 30.0, "ok", 0.1, 1.0),
        (AS_IT_IS, 30.0, "ok", 0.3, -1.0),
        (AS_IT_IS, 90.0, "ok", 0.5, 2.0),
        ("one pass", 30.0, "ok", 0.2, 3.0),
        ("one pass", 90.0, "no_convergence", np.nan, np.nan),
    ]
    table = pd.DataFrame(rows, columns=columns)
    return table.assign(r_error_deg=0.1, t_error_deg=0.05, t_d_bias_ms=0.01)


def test_means_are_of_runs_that_did_not_fail():
    means = variant_means(runs()).set_index("variant")
    assert list(means.index) == [AS_IT_IS, "one pass"]
    assert means.loc[AS_IT_IS, "t_d_error_ms"] == pytest.approx(0.3)
    assert means.loc[AS_IT_IS, "t_d_error_ms_worst"] == pytest.approx(0.5)  # at 90 deg
    assert means.loc[AS_IT_IS, "normalised_rms"] == pytest.approx(np.sqrt(2.0))
    assert list(means["failed"]) == [0, 1]
    assert means.loc["one pass", "t_d_error_ms"] == pytest.approx(0.2)


def test_the_variants_differ_from_the_method_and_from_each_other():
    assert VARIANTS[AS_IT_IS] == TangencyConfig()
    assert len(set(VARIANTS.values())) == len(VARIANTS)


def test_the_figure_has_a_bar_for_each_variant():
    joint = runs().iloc[:1].assign(variant="joint", t_d_error_ms=9.0)
    means = variant_means(pd.concat([joint, runs()]))
    t_d, R = study_figure(means).axes
    assert [bar.get_width() for bar in t_d.patches] == pytest.approx([0.3, 0.2])
    assert [bar.get_width() for bar in R.patches] == pytest.approx([0.1, 0.1])
    assert [label.get_text() for label in t_d.get_yticklabels()] == [AS_IT_IS, "one pass"]
