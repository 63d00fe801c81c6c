"""The light list of methods against the registry, and that help waits for no heavy import."""

import subprocess
import sys

import pytest

from ssac.cli.command_line import COMMANDS, command_line, run
from ssac.cli.sync import complete_method
from ssac.methods.method import Input, all_summaries, our_methods
from ssac.pipeline.registry import OURS

HEAVY = {"numba", "scipy", "cv2", "pandas", "matplotlib", "h5py", "pyrender", "trimesh"}


def test_ours_are_declared_in_their_files():
    """In the order of the paper's method, what refines it, and what it is compared with."""
    names = ["ssac", "ssac-known", "joint", "joint-known", "tangency", "tangency-known"]
    assert [method.name for method in OURS] == [*names, "albl", "zncc_e", "zncc_f", "event_rate"]
    assert list(all_summaries())[: len(OURS)] == [method.name for method in OURS]


def test_a_file_is_all_that_a_method_takes(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(
        '@method("mine-too", "the \'second\'", input=Input.RATES)\n'
        '@method(\n    "mine",\n    "the first",\n    place=3,\n)\n'
        "@cached\ndef found(views: TwoViews) -> Estimate:\n    1 / 0\n"
    )
    monkeypatch.setattr("ssac.methods.method.__file__", str(tmp_path / "method.py"))
    first, second = our_methods.__wrapped__()
    assert (first.name, first.summary, first.runs) == (
        "mine",
        "the first",
        "ssac.methods.mine:found",
    )
    assert (second.name, second.summary, second.input) == ("mine-too", "the 'second'", Input.RATES)


def test_help_lists_every_method_with_its_summary(capsys):
    assert run(command_line(COMMANDS, ""), ["sync", "--help"], "ssac") == 0
    shown = " ".join(capsys.readouterr().out.split())
    for name, summary in all_summaries().items():
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
