"""The light list of methods against the registry, and that help waits for no heavy import."""

import subprocess
import sys

import pytest

from ssac.cli.command_line import COMMANDS, command_line, run
from ssac.cli.sync import complete_method
from ssac.pipeline.registry import OURS
from ssac.pipeline.summaries import DEFAULT, SUMMARIES, all_summaries

HEAVY = {"numba", "scipy", "cv2", "pandas", "matplotlib", "h5py", "pyrender", "trimesh"}


def test_the_list_is_that_of_the_registry():
    assert {method.name: method.summary for method in OURS} == SUMMARIES
    assert [method.name for method in OURS] == list(SUMMARIES)
    assert DEFAULT in SUMMARIES
    assert list(all_summaries())[: len(SUMMARIES)] == list(SUMMARIES)


def test_help_lists_every_method_with_its_summary(capsys):
    assert run(command_line(COMMANDS, ""), ["sync", "--help"], "ssac") == 0
    shown = " ".join(capsys.readouterr().out.split())
    for name, summary in SUMMARIES.items():
        assert f"{name} {summary}" in shown


def test_a_shell_completes_a_methods_name():
    assert [name for name, _ in complete_method("zncc")] == ["zncc_e", "zncc_f"]


@pytest.mark.parametrize("module", ["ssac.cli", "experiments"])
@pytest.mark.parametrize("args", [("--help",), ("--version",), ("sync", "--help"), ("sync",)])
def test_nothing_heavy_is_imported_for_help_or_for_bad_usage(module, args):
    code = f"""
import runpy, sys
sys.argv = ["ssac", *{args!r}]
try:
    runpy.run_module({module!r}, run_name="__main__", alter_sys=True)
except SystemExit:
    pass
print(*{{name.partition(".")[0] for name in sys.modules}})
"""
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "typer" in shown.stdout.split("\n")[-2].split()
    assert not HEAVY & set(shown.stdout.split("\n")[-2].split())
