"""One folder for a module's sweeps, its tiny grid, that grid swept by one process, and a plugin."""

import pytest

from tests.experiments.sweep.tiny import PLUGIN, TOML, sweep


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("sweep")


@pytest.fixture(scope="module")
def config(folder):
    path = folder / "tiny.toml"
    path.write_text(TOML.format(methods='"ssac", "event_rate", "zncc_f"'))
    return path


@pytest.fixture(scope="module")
def whole(folder, config):
    """The sweep in one piece, by one process."""
    out = folder / "whole.csv"
    result = sweep(config, out, folder / "cache", "--workers", "1")
    assert result.exit_code == 0, result.output
    return out


@pytest.fixture(scope="module")
def plugin(folder):
    """A folder in which Python finds the plugin."""
    plugin = folder / "plugin"
    info = plugin / "failing-1.0.dist-info"
    info.mkdir(parents=True)
    (plugin / "failing.py").write_text(PLUGIN)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: failing\nVersion: 1.0\n")
    names = ("raising", "refusing", "dying_once")
    entries = "".join(f"{name} = failing:{name}\n" for name in names)
    (info / "entry_points.txt").write_text(f"[ssac.methods]\n{entries}")
    return plugin
