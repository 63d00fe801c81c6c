# Every command of this project; `make help` lists them. Each one sets up what it needs first: the
# virtual environment .venv, the pinned packages, and the system's OpenGL libraries.

# The interpreter the virtual environment is made from; empty: the first Python 3.10-3.13 found.
PYTHON ?=

# The caller's environment must not reach into ours. PIP_USER is set because it may also stand in pip's
# own configuration, which the environment overrides.
unexport VIRTUAL_ENV PYTHONPATH PYTHONHOME MYPYPATH PIP_TARGET PIP_PREFIX PIP_ROOT
export PIP_USER := 0
export PYTHONNOUSERSITE := 1

# Matplotlib keeps one list of fonts per user, which an environment that was removed may have spoiled.
export MPLCONFIGDIR := $(CURDIR)/.venv/matplotlib

RUN := .venv/bin/python -m

.DELETE_ON_ERROR:
.PHONY: help setup demo tables ablations studies figures numbers report verify test lint types bench \
	audit browser fuzz scene fidelity real outdoor network physical docs wheel clean-cache clean moved
.DEFAULT_GOAL := help

help: ## list these commands
	@awk -F ' *## *' '/^[a-z-]+:.*## / { sub(/:.*/, "", $$1); printf "  make %-11s %s\n", $$1, $$2 }' Makefile

# Commands of `ssac` with their own names; what each makes stands below.
demo tables figures numbers report verify bench scene outdoor network physical: .venv/.kernels
	@.venv/bin/ssac $@

setup: .venv/.kernels ## virtual environment, packages, OpenGL libraries (the others run this first)
	@:

demo: ## simulate two cameras, recover offset and pose, write a report (a minute) -> out/demo

tables: ## the paper's simulation tables, 300 recordings (half an hour from nothing) -> results/esim_*.csv

ablations: .venv/.kernels ## one parameter varied at a time (half an hour) -> results/ablation_*.csv, *.png
	@.venv/bin/ssac ablate

studies: .venv/.kernels ## coverage of the intervals, refusals, Cramer-Rao bound, ... (three hours) -> results/
	@.venv/bin/ssac study efficiency coverage refusal reasons imperfect marks tangency oracle
	@.venv/bin/ssac by-hand --first 5650

figures: ## the paper's figures, and those of all studies anew -> results/*.png

numbers: ## update the numbers quoted in README.md and docs/ from results/

report: ## all results on one HTML page -> out/report.html

verify: ## check that results/ is complete and follows from its runs; rerun a few (two minutes)

test: .venv/.kernels ## all tests, on up to four cores
	@$(RUN) pytest --numprocesses auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

lint: .venv/.ready ## ruff: rules and formatting; import-linter: which way imports go
	@$(RUN) ruff check
	@$(RUN) ruff format --check
	@.venv/bin/lint-imports --no-logo --no-cache

types: .venv/.ready ## mypy --strict on sim, ssac and experiments
	@$(RUN) mypy

docs: .venv/.kernels ## these pages, the tour (executed) and the API reference as HTML -> out/docs/index.html
	@rm -rf out/docs docs/generated
	@.venv/bin/sphinx-build --fail-on-warning --keep-going --quiet --jobs auto --fresh-env \
		--conf-dir docs --doctree-dir out/doctrees . out/docs
	@cp out/docs/README.html out/docs/index.html
	@echo out/docs/index.html

wheel: .venv/.ready ## build the wheel, install it in a clean environment, use it there
	@.ci/wheel

# For tests/test_browser.py, which skips what is not there.
PLAYWRIGHT := playwright==1.65.2
AXE := axe-core@4.14.1

browser: .venv/.ready ## Playwright, Chromium and axe, with which `make test` looks at the pages
	@.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-input $(PLAYWRIGHT) 2>/dev/null \
		|| { echo 'make browser: $(PLAYWRIGHT) cannot be installed' >&2; exit 1; }
	@command -v chromium >/dev/null || { [ "$$(id -u)" = 0 ] || sudo=sudo; \
		$$sudo apt-get -qq install --no-install-recommends chromium >/dev/null 2>&1; } \
		|| { echo 'make browser: chromium cannot be installed' >&2; exit 1; }
	@mkdir -p out && npm install --silent --no-fund --no-audit --prefix out $(AXE) >/dev/null 2>&1 \
		|| { echo 'make browser: $(AXE) cannot be installed' >&2; exit 1; }

audit: .venv/.ready ## known vulnerabilities of the pinned packages, by pip-audit (needs a network)
	@.venv/bin/python -m venv --clear out/audit
	@out/audit/bin/python -m pip install --quiet --disable-pip-version-check --no-input pip-audit==2.10.1
	@out/audit/bin/pip-audit --requirement requirements.txt --no-deps --disable-pip --strict --progress-spinner off

fuzz: .venv/.kernels ## thousands of damaged files of all kinds (a quarter of an hour)
	@$(RUN) pytest --quiet tests/test_damaged_inputs.py --hypothesis-profile fuzz

bench: ## speed, memory and their growth, as ratios (15 minutes) -> results/bench*.csv

scene: ## statistics of the default scene, beside the authors' sample (2 minutes)

fidelity: .venv/.kernels ## events against dense references, 20 flights (an hour) -> results/fidelity.csv
	@.venv/bin/ssac study fidelity

real: .venv/.kernels ## drone-tracking data sets, downloaded to DATA=folder: offsets, paths -> results/real_*.csv
	@.venv/bin/ssac real $(DATA)

outdoor: ## the paper's outdoor experiment, simulated: 10 flights (minutes each) -> results/outdoor.csv

network: ## many cameras: errors of four, run time with eight (half an hour) -> results/network*.csv

physical: ## the paper's small-scale experiment, simulated; error budget (hours) -> results/mini_*.csv

clean-cache: ## remove cache/: recordings and runs kept by tables, studies and sweeps
	@du -sh cache 2>/dev/null || true
	rm -rf cache

clean: ## remove everything that make created, .venv too, except results/
	rm -rf .venv build out cache docs/generated *.egg-info .pytest_cache .hypothesis .mypy_cache .ruff_cache
	find sim ssac experiments tests -name __pycache__ -prune -exec rm -rf {} +

# --- Set-up ----------------------------------------------------------------------------------------

# A virtual environment holds absolute paths, so one that was copied or moved here with the tree is
# made anew; .ready holds the folder it was made in.
ifneq ($(wildcard .venv/.ready),)
ifneq ($(shell cat .venv/.ready),$(CURDIR))
.venv/.ready: moved
endif
endif

.venv/.ready: requirements.txt pyproject.toml
	@PYTHON='$(PYTHON)' sh -euc "$$SETUP" </dev/null
	@pwd -P >$@

# Apart from the packages, as what does not simulate or estimate need not wait for them.
.venv/.kernels: .venv/.ready
	@echo "make setup: compiling kernels" >&2
	@.venv/bin/python -m experiments.warm_up
	@touch $@

# Prints what renders: osmesa (pyglet, inside pyrender, loads EGL even then), or egl where it really
# opens a display without a screen, as drivers are found only at run time.
define GL_BACKEND
import ctypes, sys
from ctypes.util import find_library
egl = find_library("EGL")
if not (egl and find_library("GL")):
    sys.exit()
if find_library("OSMesa"):
    sys.exit(print("osmesa"))
EGL_PLATFORM_SURFACELESS_MESA = 0x31DD
lib = ctypes.CDLL(egl)
lib.eglGetPlatformDisplay.restype = ctypes.c_void_p
lib.eglGetPlatformDisplay.argtypes = [ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p]
lib.eglInitialize.argtypes = [ctypes.c_void_p] * 3
display = lib.eglGetPlatformDisplay(EGL_PLATFORM_SURFACELESS_MESA, None, None)
if display and lib.eglInitialize(display, None, None):
    print("egl")
endef

define SETUP
fail() { printf 'make setup: %s\n' "$$*" >&2; exit 1; }

# apt stays silent unless it fails. A fresh machine's package lists are empty or old, so they are
# fetched when a package is unknown or cannot be downloaded.
as_root=
[ "$$(id -u)" = 0 ] || as_root="sudo -n"
apt() { $$as_root env DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=120 -o Dpkg::Use-Pty=0 "$$@"; }
apt_works() { command -v apt-get >/dev/null && apt --version >/dev/null 2>&1; }
apt_has_lists() { ls /var/lib/apt/lists/*_Packages* >/dev/null 2>&1; }
apt_knows() { apt-cache show "$$1" >/dev/null 2>&1; }
apt_install() { apt install --no-install-recommends --no-remove "$$@"; }
apt_offers() { apt-get -qq --simulate --no-remove install "$$1" >/dev/null 2>&1; }
add_packages() {
    echo "make setup: installing" "$$@" "(apt)" >&2
    apt_install "$$@" >/dev/null 2>&1 || log=$$(apt update 2>&1 && apt_install "$$@" 2>&1)
}

# Python: in PATH, whatever is called python3 comes first, as it is what the user means.
supported='import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))'
is_supported() { "$$1" -c "$$supported" >/dev/null 2>&1; }
find_python() {
    for python in "$${PYTHON:-python3}" python3.13 python3.12 python3.11 python3.10; do
        is_supported "$$python" && return
        [ -z "$$PYTHON" ] || fail "PYTHON=$$PYTHON is not a Python 3.10-3.13"
    done
    python=
}
has_venv() { "$$python" -c 'import ensurepip, venv' >/dev/null 2>&1; }
gl_backend() { "$$python" -c "$$GL_BACKEND" 2>/dev/null || true; }
find_python

# What the system lacks. Debian and Ubuntu ship Python's venv apart; some have a second, older Python.
packages= gl=
if [ -n "$$python" ]; then
    has_venv || packages=$$("$$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
    gl=$$(gl_backend)
fi
if [ "$$gl" != osmesa ] && apt_works && ! apt_has_lists; then apt update >/dev/null 2>&1 || true; fi
if [ -z "$$gl" ]; then
    # Mesa 25.1 dropped OSMesa, so the newest systems have no libosmesa6: EGL does it there.
    if apt_offers libosmesa6; then opengl=libosmesa6; else opengl="libegl-mesa0 libgl1-mesa-dri"; fi
    packages="$$packages libegl1 libgl1 $$opengl"
fi
if [ -z "$$python" ]; then
    apt_python=
    if apt-cache show python3 2>/dev/null | grep -q '^Version: 3\.1[0-3]\.'; then
        apt_python="python3 python3-venv"
    else
        for v in 3.13 3.12 3.11 3.10; do
            if apt_knows "python$$v-venv"; then apt_python="python$$v python$$v-venv"; break; fi
        done
    fi
    [ -n "$$apt_python" ] || fail "no Python 3.10-3.13 here; install one (apt-get install python3 python3-venv, if that is not newer), or name one: make PYTHON=/path/to/python3.13"
    packages="$$apt_python $$packages"
fi
if [ -n "$$packages" ]; then
    apt_works || fail "the system lacks some packages, and neither root nor sudo is at hand: apt-get install" $$packages
    add_packages $$packages || fail "apt failed: $$log"
    [ -n "$$python" ] || find_python
fi
has_venv || fail "$$python has no working venv and ensurepip"
# Everybody's recordings are checked by the same OpenGL where that is possible; EGL does it as well.
if [ "$$gl" = egl ] && apt_works && apt_offers libosmesa6; then add_packages libosmesa6 || true; fi
gl=$$(gl_backend)
[ -n "$$gl" ] || fail "OpenGL opens neither through OSMesa nor through EGL"
[ "$$gl" = osmesa ] || echo "make setup: rendering with EGL, as OSMesa is not here (apt-get install libosmesa6, as root, where the system offers it)" >&2

# The virtual environment, the pins, and this project itself (editable: its source stays here). What
# was added to .venv by hand survives a change of the pins.
[ -z "$$PYTHON" ] && [ "$$(cat .venv/.ready 2>/dev/null)" = "$$(pwd -P)" ] && is_supported .venv/bin/python ||
    "$$python" -m venv --clear .venv
echo "make setup: installing Python packages into .venv ($$(.venv/bin/python --version))" >&2
pip() { .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-input --no-deps "$$@"; }
pip --no-compile -r requirements.txt
pip --no-build-isolation --editable .
# Here, since containers often forbid Python to keep what it compiled: each command would do it again.
# pip would use one core, and stop at nothing that is no Python either.
.venv/bin/python -m compileall -qq -j 0 -x /tests/ .venv/lib ssac sim experiments || true
endef
export GL_BACKEND SETUP
