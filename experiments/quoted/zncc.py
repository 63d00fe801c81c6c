"""Results in, the tables that docs/zncc.md shows out as Markdown, each under a name."""

from collections.abc import Callable, Mapping

from experiments.lab.markdown import markdown_table
from experiments.lab.results import Results
from experiments.paper.grids import ANGLES_DEG, DURATIONS_S

_ANGLE_HEADER = [f"{angle:g} deg" for angle in ANGLES_DEG]
_BINS = ("bins of 5 ms", "bins of 20 ms", "bins of 50 ms")


def correlation_table(results: Results) -> str:
    """Correlation of the two views at the true lag, default scene, 20 s."""

    def row(words: str, source: str, signal: str, column: str = "at_truth") -> list[str]:
        return [words, *_by_angle(results, source, signal, column, "{:.2f}")]

    rows = [
        row("speed across the line of sight (model)", "modelled", "speed"),
        row("1 / distance squared (model)", "modelled", "distance"),
        row("event rate (model)", "modelled", "rate"),
        row("event rate, rendered: `zncc_e`", "rendered", "zncc_e"),
        row("mean brightness of a frame: `zncc_f`", "rendered", "zncc_f"),
        row("change from frame to frame", "rendered", "frame changes"),
        row("highest value elsewhere (event rate, model)", "modelled", "rate", "elsewhere"),
    ]
    return markdown_table(["", *_ANGLE_HEADER], rows)


def gross_table(results: Results) -> str:
    """How many errors are gross, and what their mean is, at 90 deg and 20 s."""
    cases = (
        ("event rate, rendered: `zncc_e`", "rendered", "zncc_e"),
        ("event rate, model", "modelled", "rate"),
        ("change from frame to frame, rendered", "rendered", "frame changes"),
        ("mean brightness, rendered: `zncc_f`", "rendered", "zncc_f"),
    )
    columns = (("flights", "{:.0f}"), ("at_truth", "{:.2f}"), ("error_ms_mean", "{:.0f}"))
    rows = []
    for words, source, signal in cases:
        of = {"scene": "default", "duration_s": 20, "angle_deg": 90}
        of |= {"source": source, "signal": signal}
        shown = [form.format(results.value("zncc", c, **of)) for c, form in columns]
        gross = 100 * results.value("zncc", "gross_share", **of)
        rows.append([words, *shown, f"{gross:.0f} %"])
    header = ["90 deg, 20 s", "flights", "correlation at the true lag", "mean error [ms]"]
    return markdown_table([*header, "errors above 100 ms"], rows)


def vertical_table(results: Results) -> str:
    """Errors and correlations of the modelled event rate as the vertical motion shrinks."""
    scenes = (
        ("default", "3.2, 3.2, 3.6 (default)"),
        ("vertical 3 m", "3.2, 3.2, 3.0"),
        ("flatter", '3.4, 3.4, 3.0 ("flatter")'),
        ("vertical 2.4 m", "3.2, 3.2, 2.4"),
        ("vertical 1.8 m", "3.2, 3.2, 1.8"),
        ("vertical 1.2 m", "3.2, 3.2, 1.2"),
    )
    rows = []
    for duration_s in reversed(DURATIONS_S):
        for scene, words in scenes if duration_s == 20 else scenes[:1]:
            means, shares = (
                _by_angle(results, "modelled", "rate", column, form, scene, duration_s)
                for column, form in (("error_ms_mean", "{:.0f}"), ("at_truth", "{:.2f}"))
            )
            cells = [f"{mean} ({share})" for mean, share in zip(means, shares, strict=True)]
            rows.append([f"{words}, {duration_s:g} s", *cells])
        rows.append(
            [f"paper, ZNCC_E, {duration_s:g} s", *_published(results, "zncc_e", duration_s)]
        )
    return markdown_table(["multipliers x, y, z [m]", *_ANGLE_HEADER], rows)


def frames_table(results: Results) -> str:
    """Lay out errors and their deviations of what ZNCC_F may take of a frame, over 20 s."""
    cases = (
        ("1 / distance squared (model)", "modelled", "distance"),
        ("mean brightness: `zncc_f`", "rendered", "zncc_f"),
        ("change from frame to frame", "rendered", "frame changes"),
    )
    rows = []
    for words, source, signal in cases:
        means = _by_angle(results, source, signal, "error_ms_mean", "{:.0f}")
        stds = _by_angle(results, source, signal, "error_ms_std", "{:.0f}")
        cells = [f"{mean} ({std})" for mean, std in zip(means, stds, strict=True)]
        rows.append([words, *cells])
    rows.insert(0, ["paper, ZNCC_F", *_published(results, "zncc_f", 20)])
    return markdown_table(["mean error (deviation) [ms]", *_ANGLE_HEADER], rows)


def variants_table(results: Results) -> str:
    """Lay out what changes `zncc_e` little, over the same flights at 90 deg."""
    of = {"scene": "default", "duration_s": 20, "angle_deg": 90, "source": "rendered"}
    signals = ("zncc_e", *(f"zncc_e, {v}" for v in ("raw events", *_BINS)))
    rows = [
        [
            signal,
            f"{results.value('zncc', 'at_truth', signal=signal, **of):.2f}",
            f"{results.value('zncc', 'error_ms_mean', signal=signal, **of):.0f}",
        ]
        for signal in signals
    ]
    turning = of | {"scene": "no turning"}
    for signal in ("zncc_e", "zncc_f"):
        at_truth, error = (
            results.value("zncc", column, signal=signal, **turning)
            for column in ("at_truth", "error_ms_mean")
        )
        rows.append([f"{signal}, a drone that does not turn", f"{at_truth:.2f}", f"{error:.0f}"])
    return markdown_table(["signal", "correlation at the true lag", "mean error [ms]"], rows)


def scenes_table(results: Results) -> str:
    """Set the scene, and the flatter one, beside the authors' sample, at 90 deg and 20 s."""
    quantities = (
        ("median image speed [px/s]", "198", "speed_px_s", "{:.0f}"),
        ("sample times valid in both views, of 400", "348", "n_valid", "{:.0f}"),
        ("slope of d_avg [px per 10 ms]", "1.3", "slope_px", "{:.2f}"),
        ("`zncc_e` [ms]", "", "error_ms_mean", "{:.0f}"),
    )
    of = {"source": "rendered", "signal": "zncc_e", "duration_s": 20, "angle_deg": 90}
    rows = [
        [
            words,
            authors,
            *(
                form.format(results.value("zncc", column, scene=scene, **of))
                for scene in ("default", "flatter")
            ),
        ]
        for words, authors, column, form in quantities
    ]
    return markdown_table(["", "authors' sample", "default", "flatter"], rows)


def _by_angle(
    results: Results,
    source: str,
    signal: str,
    column: str,
    form: str,
    scene: str = "default",
    duration_s: float = 20,
) -> list[str]:
    of = {"source": source, "signal": signal, "scene": scene, "duration_s": duration_s}
    return [
        form.format(results.value("zncc", column, angle_deg=angle, **of)) for angle in ANGLES_DEG
    ]


def _published(results: Results, method: str, duration_s: float) -> list[str]:
    of = {"quantity": f"{method}_t_d_error_ms", "duration_s": duration_s}
    return [
        " ".join(
            form.format(
                results.column("comparison", f"published_{c}", angle_deg=angle, **of).mean()
            )
            for c, form in (("mean", "{:.0f}"), ("std", "({:.0f})"))
        )
        for angle in ANGLES_DEG
    ]


ZNCC_TABLES: Mapping[str, Callable[[Results], str]] = {
    "table.zncc.correlation": correlation_table,
    "table.zncc.gross": gross_table,
    "table.zncc.vertical": vertical_table,
    "table.zncc.frames": frames_table,
    "table.zncc.variants": variants_table,
    "table.zncc.scenes": scenes_table,
}
