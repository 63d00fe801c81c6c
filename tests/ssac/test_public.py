"""The names that `from ssac import ...` gives, each imported when it is first asked for."""

import ast
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import ssac
from ssac.methods.method import our_methods


@pytest.mark.parametrize("name", ssac.__all__)
def test_a_public_name_is_what_its_module_defines(name: str) -> None:
    value = getattr(ssac, name)
    assert getattr(value, "__name__", name) == name
    assert name in dir(ssac)


def test_the_public_names_are_these() -> None:
    types = (
        "Answer Camera Cameras Chain Clock ClockJump Config EVENT_DTYPE Estimate EventFile Input"
        " Known Method NetworkResult ObjectMotion Observation Pairs PairsAt PluginError PointTrack"
        " Reading Result Rig Signal SsacError Status TwoViews"
    )
    methods = "albl event_rate joint joint_known ssac_known tangency tangency_known zncc_e zncc_f"
    others = (
        "binned checked correlation_estimate counted lags_of load_events load_rig load_track sync"
        " two_views usable_events zncc"
    )
    assert set(ssac.__all__) == {*types.split(), *methods.split(), *others.split()}


def test_functions_of_methods_have_their_types() -> None:
    tree = ast.parse(Path(str(ssac.__file__)).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    typed = {ast.unparse(node.target) for node in block.body if isinstance(node, ast.AnnAssign)}
    assert typed == {"__version__", *(one.name.replace("-", "_") for one in our_methods())}


def test_other_names_are_what_they_say() -> None:
    names: dict[str, object] = {}
    exec("import ssac\nfrom ssac import *", names)
    assert names["ssac"] is ssac  # whose name the paper's method has
    assert callable(ssac.ssac)
    assert ssac.__version__ == version("ssac-suite")
    with pytest.raises(AttributeError, match="has no attribute 'jiont'"):
        ssac.jiont  # noqa: B018


def test_the_package_alone_imports_no_compiler_and_no_solver() -> None:
    code = "import sys, ssac; print(*{name.partition('.')[0] for name in sys.modules})"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numba", "scipy", "cv2", "pandas", "matplotlib"} & set(shown.stdout.split())
