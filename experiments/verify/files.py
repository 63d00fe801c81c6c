"""A folder of results and its manifest in; whether it is whole and as it was written, out."""

import json
import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.bench.growth import COLUMNS as GROWTH_COLUMNS
from experiments.bench.growth import COMMITTED, STEPS, points_of
from experiments.bench.measurement import Measurement
from experiments.damage.reliability import CSV_FILE as RELIABILITY_FILE
from experiments.damage.reliability import reliability_faults
from experiments.lab.files import SUMS_FILE, read_checksums, sha256
from experiments.lab.finding import Finding, found
from experiments.lab.provenance import versions
from experiments.real.pairs import PAIRS_FILE
from experiments.verify.manifest import (
    BENCH_FILE,
    GROWTH_FILE,
    PUBLISHED_SHA256,
    Manifest,
    Provenance,
)
from experiments.verify.real import real_faults
from sim.render.gl_context import context_or_none
from ssac.errors import SsacError
from ssac.estimate import Status

_CLEAN_COMMIT = re.compile(r"[0-9a-f]{7,40}")
_MERGED = "ssac merge"
_SHARD = "shard"  # of a config: says which part was run, not what


def file_findings(results: Path, manifest: Manifest) -> list[Finding]:
    """Check that every file is there, no other, each as it was written and saying how."""
    findings = [
        found("every file that there must be is there", lambda: _missing(results, manifest)),
        found("no other file is there", lambda: _others(results, manifest)),
        found(f"all files are as {SUMS_FILE} has them", lambda: _changed(results, manifest)),
        found("published/ holds the paper's tables", lambda: _published(results)),
        found(f"{BENCH_FILE} is a benchmark", lambda: _bench(results / BENCH_FILE)),
        found(f"{GROWTH_FILE} has every point", lambda: _growth(results / GROWTH_FILE)),
    ]
    if PAIRS_FILE in manifest.files:
        findings.append(found(f"{PAIRS_FILE} makes sense", lambda: real_faults(results)))
    if RELIABILITY_FILE in manifest.files:
        what = f"{RELIABILITY_FILE}: every case is there, and none ended as it must not"
        findings.append(found(what, lambda: reliability_faults(results)))
    for one in manifest.provenances:
        what = f"{one.name}: a clean commit, today's configuration, versions"
        findings.append(found(what, partial(_provenance, results / one.name, one)))
    return findings


def read_text(path: Path) -> str:
    """Read a file of the results; SsacError when it cannot be read."""
    try:
        return path.read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SsacError(f"{path} cannot be read: {error}") from error


def read_provenance(path: Path) -> list[dict[str, Any]]:
    """Read what a result was made with: once, or once for each shard that was merged."""
    try:
        content = json.loads(read_text(path))
    except ValueError as error:
        raise SsacError(f"{path} is no JSON: {error}") from error
    if not isinstance(content, dict):
        raise SsacError(f"{path} holds no provenance")
    return content["shards"] if content.get("command") == _MERGED else [content]


def same_driver(path: Path) -> bool:
    """Return whether the OpenGL driver that drew a result is here; OSMesa and EGL draw alike."""
    here = context_or_none()
    drawn = [one.get("gl") or {} for one in read_provenance(path)]
    return here is not None and all(
        (gl.get("renderer"), gl.get("version")) == (here.renderer, here.version) for gl in drawn
    )


def _missing(results: Path, manifest: Manifest) -> tuple[str, ...]:
    names = (*manifest.files, SUMS_FILE)
    return tuple(name for name in names if not (results / name).is_file())


def _others(results: Path, manifest: Manifest) -> tuple[str, ...]:
    expected = {*manifest.files, SUMS_FILE}
    there = {p.relative_to(results).as_posix() for p in results.rglob("*") if not p.is_dir()}
    return tuple(sorted(there - expected))


def _changed(results: Path, manifest: Manifest) -> tuple[str, ...]:
    sums = read_checksums(results)
    faults = [f"{name} is not listed" for name in manifest.files if name not in sums]
    for name, digest in sums.items():
        path = results / name
        if not path.is_file():
            faults.append(f"{name} is listed, and is not there")
        elif sha256(path) != digest:
            faults.append(f"{name} was changed after it was written")
    return tuple(faults)


def _published(results: Path) -> tuple[str, ...]:
    return tuple(
        f"{name} was changed"
        for name, digest in PUBLISHED_SHA256.items()
        if sha256(results / name) != digest
    )


def _provenance(path: Path, expected: Provenance) -> tuple[str, ...]:
    faults = []
    for one in read_provenance(path):
        commit, command = str(one.get("commit")), str(one.get("command"))
        if not _CLEAN_COMMIT.fullmatch(commit):
            faults.append(f"its commit is {commit}: commit the code, then make it again")
        if command.partition(f" --{_SHARD}")[0] != expected.command:
            faults.append(f"it was made by `{command}`, expected `{expected.command}`")
        config = {key: value for key, value in one["config"].items() if key != _SHARD}
        if config != expected.config:
            wrong = sorted(
                key
                for key in {*config, *expected.config}
                if config.get(key) != expected.config.get(key)
            )
            faults.append(f"its configuration is not today's: {', '.join(wrong)}")
        absent = set(versions()) - set(one["versions"])
        if absent:
            faults.append(f"it lacks the versions of {', '.join(sorted(absent))}")
        has_gl = {"backend", "renderer", "version"} <= set(one["gl"] or {})
        if expected.is_drawn and not has_gl:
            faults.append("it does not say which OpenGL drew")
        if not 0.0 <= one["wall_time_s"] < np.inf:
            faults.append(f"it took {one['wall_time_s']} s")
    return tuple(faults)


def _bench(path: Path) -> tuple[str, ...]:
    """Check shape and ranges: what was measured cannot be made again."""
    table = pd.read_csv(path, keep_default_na=False, na_values={"value": [""], "mark": [""]})
    columns = [*Measurement.__dataclass_fields__, "verdict"]
    there = [str(name) for name in table]
    if there != columns:
        return (f"its columns are {', '.join(there)}; expected {', '.join(columns)}",)
    twice = table.duplicated(["name", "unit"])
    faults = [f"{name} is there twice" for name in table.loc[twice, "name"]]
    for row in table.to_dict("records"):
        mark = None if np.isnan(row["mark"]) else float(row["mark"])
        one = Measurement(
            row["name"], float(row["value"]), row["unit"], mark, bool(row["higher_is_better"])
        )
        if not 0.0 < one.value < np.inf:
            faults.append(f"{one.name} is {one.value}")
        if not (isinstance(one.unit, str) and one.unit):
            faults.append(f"{one.name} has no unit")
        if one.verdict != row["verdict"]:
            faults.append(f"{one.name} is {one.value:g}, so it is not so that it {row['verdict']}")
    return tuple(faults) if len(table) else ("it is empty",)


def _growth(path: Path) -> tuple[str, ...]:
    """Check that both steps of each point were measured, and that the pair was synchronised."""
    table = pd.read_csv(path, keep_default_na=False, na_values={"t_d_error_ms": [""]})
    there = [str(name) for name in table]
    if there != list(GROWTH_COLUMNS):
        return (f"its columns are {', '.join(there)}; expected {', '.join(GROWTH_COLUMNS)}",)
    rows = zip(table["sensor"], table["duration_s"], table["step"], strict=True)
    expected = [
        (one.sensor, one.duration_s, step) for one in points_of(COMMITTED) for step in STEPS
    ]
    if list(rows) != expected:
        return (f"its points are not the {len(expected)} of today's benchmark",)
    faults = []
    for row in table.to_dict("records"):
        name = f"{row['sensor']}, {row['duration_s']:g} s, {row['step']}"
        if row["status"] != Status.OK.value:
            faults.append(f"{name}: {row['status']}")
        faults += [
            f"{name}: {column} is {row[column]}"
            for column in ("events_per_camera", "wall_s", "cpu_s", "peak_mb")
            if not 0.0 < float(row[column] or "nan") < np.inf
        ]
    return tuple(faults)
