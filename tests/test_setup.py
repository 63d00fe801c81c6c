"""Tests `make setup` on machines with other OpenGL libraries, imitated by commands in PATH."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# A stand-in for Python: it finds the library that `gl` names, does no more, and is .venv's too.
PYTHON = """
case "$*" in
    *find_library*) cat "$MACHINE/gl" ;;
    *--clear*) mkdir -p .venv/bin && cp "$0" .venv/bin/python ;;
esac
"""
# A stand-in for apt-get: it installs packages in `offered`, and records them in `installed`.
APT = """
case "$*" in
    *install*) ;;
    *) exit 0 ;;
esac
for package; do
    case $package in lib*) grep -qx "$package" "$MACHINE/offered" || exit 100 ;; esac
done
case "$*" in *simulate*) exit 0 ;; esac
[ -z "$BROKEN" ] || exit 100
for package; do
    case $package in lib*) echo "$package" >>"$MACHINE/installed" ;; esac
done
case "$*" in *libosmesa6*) echo osmesa ;; *) echo egl ;; esac >"$MACHINE/gl"
"""

OSMESA = "libosmesa6"
EGL = ("libegl1", "libgl1", "libegl-mesa0", "libgl1-mesa-dri")
ROOT_ID, USER_ID = 0, 1000


@pytest.mark.parametrize(
    ("gl", "offered", "user", "broken", "installs", "says"),
    [
        ("osmesa", (OSMESA, *EGL), ROOT_ID, "", [], ""),
        ("egl", (OSMESA, *EGL), ROOT_ID, "", [OSMESA], ""),
        ("egl", (OSMESA, *EGL), USER_ID, "", [], "make setup: rendering with EGL, as OSMesa is"),
        ("egl", EGL, ROOT_ID, "", [], "make setup: rendering with EGL, as OSMesa is not here"),
        ("egl", (OSMESA, *EGL), ROOT_ID, "yes", [], "make setup: rendering with EGL, as OSMesa is"),
        ("", (OSMESA, *EGL), ROOT_ID, "", ["libegl1", "libgl1", OSMESA], ""),
        ("", EGL, ROOT_ID, "", list(EGL), "rendering with EGL"),
        ("", (OSMESA, *EGL), USER_ID, "", None, f"apt-get install libegl1 libgl1 {OSMESA}"),
    ],
    ids=["OSMesa is there", "EGL is there", "EGL, no root", "EGL, OSMesa is not offered",
         "EGL, OSMesa cannot be downloaded", "nothing is there", "nothing, only EGL is offered",
         "nothing, no root"],
)  # fmt: skip
def test_what_is_lacking_is_installed_or_named(tmp_path, gl, offered, user, broken, installs, says):
    """OSMesa is preferred, a working EGL suffices; `installs` is None where `make setup` fails."""
    tools = tmp_path / "tools"
    tools.mkdir()
    (tmp_path / "gl").write_text(gl)
    (tmp_path / "offered").write_text("\n".join(offered))
    (tmp_path / "installed").touch()
    said = {"python3": PYTHON, "apt-get": APT, "id": f"echo {user}", "sudo": "exit 1"}
    for name, lines in said.items():
        (tools / name).write_text(f"#!/bin/sh\n{lines}\n")
        (tools / name).chmod(0o755)
    for name in ("Makefile", "requirements.txt", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    path = f"{tools}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["make", "setup", "PYTHON="], cwd=tmp_path, capture_output=True, text=True, check=False,
        env={"PATH": path, "MACHINE": str(tmp_path), "BROKEN": broken},
    )  # fmt: skip
    assert (done.returncode == 0) == (installs is not None)
    assert (tmp_path / "installed").read_text().split() == (installs or [])
    assert says in done.stderr
    assert ("EGL" in done.stderr) == ("EGL" in says)
