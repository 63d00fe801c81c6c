"""`make setup` on machines with other OpenGL libraries, of which commands in PATH act a part."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# A Python that finds what `gl` names, and takes the rest as done: also when it is .venv's own.
PYTHON = """
case "$*" in
    *find_library*) cat "$MACHINE/gl" ;;
    *--clear*) mkdir -p .venv/bin && cp "$0" .venv/bin/python ;;
esac
"""
# An apt that installs packages in `offered`, and writes down what it installed.
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


def set_up(folder: Path, gl: str, offered: tuple[str, ...], user: int = ROOT_ID, broken: str = ""):
    """Return how `make setup` ended, and the system's packages that it installed."""
    tools = folder / "tools"
    tools.mkdir()
    (folder / "gl").write_text(gl)
    (folder / "offered").write_text("\n".join(offered))
    (folder / "installed").touch()
    said = {"python3": PYTHON, "apt-get": APT, "id": f"echo {user}", "sudo": "exit 1"}
    for name, lines in said.items():
        (tools / name).write_text(f"#!/bin/sh\n{lines}\n")
        (tools / name).chmod(0o755)
    for name in ("Makefile", "requirements.txt", "pyproject.toml"):
        shutil.copy(ROOT / name, folder)
    path = f"{tools}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["make", "setup", "PYTHON="], cwd=folder, capture_output=True, text=True, check=False,
        env={"PATH": path, "MACHINE": str(folder), "BROKEN": broken},
    )  # fmt: skip
    return done, (folder / "installed").read_text().split()


def test_where_osmesa_is_nothing_is_installed(tmp_path):
    done, installed = set_up(tmp_path, "osmesa", (OSMESA, *EGL))
    assert done.returncode == 0
    assert installed == []
    assert "EGL" not in done.stderr


def test_osmesa_is_installed_beside_an_egl_that_works(tmp_path):
    done, installed = set_up(tmp_path, "egl", (OSMESA, *EGL))
    assert done.returncode == 0
    assert installed == [OSMESA]
    assert "EGL" not in done.stderr


@pytest.mark.parametrize(
    ("offered", "user", "broken"),
    [((OSMESA, *EGL), USER_ID, ""), (EGL, ROOT_ID, ""), ((OSMESA, *EGL), ROOT_ID, "yes")],
    ids=["no root", "not offered", "cannot be downloaded"],
)
def test_an_egl_that_works_is_enough(tmp_path, offered, user, broken):
    done, installed = set_up(tmp_path, "egl", offered, user, broken)
    assert done.returncode == 0
    assert installed == []
    assert "make setup: rendering with EGL, as OSMesa is not here" in done.stderr


def test_without_opengl_osmesa_comes_first(tmp_path):
    done, installed = set_up(tmp_path, "", (OSMESA, *EGL))
    assert done.returncode == 0
    assert installed == ["libegl1", "libgl1", OSMESA]


def test_without_opengl_egl_is_installed_where_there_is_no_osmesa(tmp_path):
    done, installed = set_up(tmp_path, "", EGL)
    assert done.returncode == 0
    assert installed == list(EGL)
    assert "rendering with EGL" in done.stderr


def test_without_opengl_and_root_it_says_what_is_lacking(tmp_path):
    done, _ = set_up(tmp_path, "", (OSMESA, *EGL), USER_ID)
    assert done.returncode != 0
    assert f"apt-get install libegl1 libgl1 {OSMESA}" in done.stderr
