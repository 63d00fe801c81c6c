"""A configuration and a seed in; a recording as a folder, and a few lines about it, out."""

from pathlib import Path

from experiments.lab.provenance import plain, versions
from sim.disturb import DisturbConfig, record_disturbed
from sim.recorded import Flight
from sim.recording import SimConfig
from sim.storage import Recorded, record
from ssac.console.progress import progress

MAX_SEED = 2**32 - 1


def record_with_progress(
    config: SimConfig,
    seed: int,
    out_dir: Path,
    text: bool = False,
    disturb: DisturbConfig | None = None,
) -> Recorded:
    """Simulate into a folder, and show on stderr how far it is."""
    provenance = {"config": plain(config), "seed": seed, "versions": versions()}
    with progress(100, "simulating", is_brief=True) as advance:  # no bar before bad input is found

        def show(share: float) -> None:
            advance(round(100 * share))

        if disturb is None or disturb.is_none:
            return record(config, seed, out_dir, provenance, text, show)
        return record_disturbed(config, disturb, seed, out_dir, provenance, text, show)


def summary(recorded: Recorded, out_dir: Path) -> str:
    """Say in a few lines what was recorded and where it lies."""
    flight = recorded.flight
    lines = [
        f"{camera.name}: {n_events} events, {n_frames} frames"
        for camera, n_events, n_frames in zip(
            flight.rig.cameras, recorded.n_events, recorded.n_frames, strict=True
        )
    ]
    lines.extend(_drawn_by(flight))
    lines.append(f"written to {out_dir}")
    return "\n".join(lines)


def _drawn_by(flight: Flight) -> list[str]:
    """Name what drew, and how far it was from the definition."""
    gl, check = flight.gl, flight.check
    by_gl = f"{gl.backend} ({gl.renderer})" if gl else "the native renderer"
    if not check.n_instants:
        return [f"{flight.n_instants} instants rendered with {by_gl}"]
    return [
        f"{flight.n_instants} instants rendered with the native renderer",
        f"{check.n_instants} of them with {by_gl} too: luminance differs by "
        f"{check.mean_difference:.0e} in the mean, {check.max_difference:.0e} at most",
    ]
