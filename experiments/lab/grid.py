"""Grids of parameters read from TOML files: they list all runs of a table, ablation or sweep.

docs/sweeps.md has an example. Parameters are the fields of `sim.recording.SimConfig` and
`ssac.config.Config`, by dotted names. A file that comes with the project is named by its path in
CONFIGS ("backgrounds/leaves.png"); any other path is used as given.
"""

import hashlib
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

from experiments.lab.cell import FlightCell
from experiments.lab.results import DIGITS
from sim.errors import SimError
from sim.recording import SimConfig, two_view_rig_of
from ssac.config import Config, checked
from ssac.errors import SsacError
from ssac.files.damage import brief
from ssac.pipeline.registry import METHODS, choose_method

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

CONFIGS = Path(__file__).parents[1] / "configs"

MAX_CELLS = 1_000_000  # most runs of a grid: they would take a year
MAX_DURATION_S = 3600.0  # longest flight, as for `ssac simulate`

_KEYS = ("title", "flights", "first_flight", "methods", "search_around_truth_s",
         "fixed", "grid", "together", "figure")  # fmt: skip
_ROOTS: dict[str, Any] = {"sim": SimConfig(), "ssac": Config()}

Changed = TypeVar("Changed")


@dataclass(frozen=True)
class Cell(FlightCell):
    """One run of a method on a flight, to which the offset is added: `t_d_s` of its `sim` is 0."""

    t_d_s: float
    estimator: Config
    method: str  # name in the registry
    parameters: Mapping[str, Any]  # dotted name -> value: all that the grid's TOML sets

    @property
    def columns(self) -> dict[str, Any]:
        """Columns that identify the run in its row."""
        named = {"flight": self.flight, "seed": self.seed, "method": self.method}
        return {**self.parameters, **named}

    @property
    def inputs(self) -> tuple[Any, ...]:
        """All that the row depends on besides recording and code."""
        return self.t_d_s, self.estimator, self.method, METHODS[self.method].version


@dataclass(frozen=True)
class FigureConfig:
    """How an ablation or a sweep is drawn."""

    x: str  # dotted name of the parameter along the axis
    label: str
    scale: float = 1.0  # from the parameter's unit to the label's
    log: bool = False


@dataclass(frozen=True)
class GridConfig:
    """A table, an ablation or a sweep."""

    name: str
    title: str
    flights: int  # at each point
    first_flight: int
    methods: tuple[str, ...]
    search_around_truth_s: tuple[float, float] | None  # None: the estimator's own interval
    fixed: Mapping[str, Any]
    axes: tuple[tuple[Mapping[str, Any], ...], ...]  # the points of each axis
    figure: FigureConfig | None = None
    content: Mapping[str, Any] = field(default_factory=dict)  # the TOML, for provenance

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the parameters that the grid varies."""
        return tuple(name for axis in self.axes for name in axis[0])

    def cells(self) -> list[Cell]:
        """List all cells: the grid's points in order, then flights, then methods."""
        cells: list[Cell] = []
        flights = range(self.first_flight, self.first_flight + self.flights)
        for point in product(*self.axes):
            parameters = {**self.fixed, **{k: v for part in point for k, v in part.items()}}
            sim, estimator = configs_of(parameters)
            if self.search_around_truth_s is not None:
                low, high = self.search_around_truth_s
                estimator = replace(estimator, interval_s=(sim.t_d_s + low, sim.t_d_s + high))
            checked(estimator)
            two_view_rig_of(sim)  # which checks the cameras
            duration_s = sim.spline.duration_s
            if not 0.0 < duration_s <= MAX_DURATION_S:
                raise SsacError(
                    f"sim.spline.duration_s: expected up to {MAX_DURATION_S:g} s, got "
                    f"{duration_s:g}"
                )
            recorded = replace(sim, t_d_s=0.0)
            for flight, method in product(flights, self.methods):
                seed = flight_seed(duration_s, sim.angle_deg, flight)
                one = Cell(recorded, flight, seed, sim.t_d_s, estimator, method, parameters)
                cells.append(one)
        return cells


def flight_seed(duration_s: float, angle_deg: float, flight: int, base_seed: int = 0) -> int:
    """Return the seed of a flight, so that flights of other durations or angles are independent.

    It is a hash, since flights of one seed are not independent: a flight of 10 s is the first half
    of the flight of 20 s with its seed, and views of one flight from two angles err alike. The seed
    depends on nothing else, so that all offsets, methods and other parameters are compared on the
    same flights. Another `base_seed` gives another set of flights.
    """
    text = f"{base_seed} {float(duration_s)!r} {float(angle_deg)!r} {flight}"
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


def load_config(path: Path) -> GridConfig:
    """Read a grid; SsacError, which names file and key, if it cannot be read or makes no sense."""
    try:
        with path.open("rb") as file:
            content = tomllib.load(file)
    except (OSError, ValueError, RecursionError) as error:  # of its syntax, or not UTF-8
        raise SsacError(f"{path}: cannot be read as TOML: {brief(error)}") from error
    try:
        return grid_from_content(path.stem, content)
    except (SimError, SsacError) as error:
        raise SsacError(f"{path}: {error}") from error
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise SsacError(f"{path}: a value makes no sense: {brief(error)}") from error


def named_config(name: str) -> GridConfig:
    """Read one of the grids that come with the project."""
    return load_config(CONFIGS / f"{name}.toml")


def config_names(prefix: str) -> list[str]:
    """List the names, with this prefix, of the grids that come with the project."""
    return sorted(path.stem for path in CONFIGS.glob(f"{prefix}*.toml"))


def grid_from_content(name: str, content: Mapping[str, Any]) -> GridConfig:
    """Check what a TOML file holds, and build the grid; SsacError when it makes no sense."""
    for key in content:
        if key not in _KEYS:
            raise SsacError(f"unknown key {key!r}: known are {', '.join(_KEYS)}")
    methods = content.get("methods", tuple(METHODS))
    if not isinstance(methods, (list, tuple)) or {type(one) for one in methods} != {str}:
        raise SsacError(f"methods must be a list of names, got {methods!r}")
    for method in methods:
        choose_method(method)
    _check_once("methods", methods)
    flights, first_flight = content.get("flights", 10), content.get("first_flight", 0)
    if not (type(flights) is int and flights > 0):
        raise SsacError(f"flights must be a positive integer, got {flights!r}")
    if not (type(first_flight) is int and 0 <= first_flight <= MAX_CELLS):
        raise SsacError(f"first_flight must be 0 or a positive integer, got {first_flight!r}")
    fixed = dict(_flat(content.get("fixed", {})))
    together = content.get("together", {})
    if not isinstance(together, Mapping):
        raise SsacError(f"together must be a table of tables, got {together!r}")
    lone = [_axis(key, {key: values}) for key, values in _flat(content.get("grid", {}))]
    axes = lone + [_axis(f"together.{key}", dict(_flat(part))) for key, part in together.items()]
    n_cells = flights * len(methods) * math.prod(map(len, axes))
    if n_cells > MAX_CELLS:
        raise SsacError(f"the grid has {n_cells} runs, and {MAX_CELLS} are the most: split it")
    title = content.get("title", name)
    if not isinstance(title, str):
        raise SsacError(f"title must be a text, got {title!r}")
    grid = GridConfig(
        name,
        title,
        flights,
        first_flight,
        tuple(methods),
        _interval(content.get("search_around_truth_s")),
        fixed,
        tuple(axes),
        _figure(content.get("figure")),
        content,
    )
    names = [*fixed, *grid.varied]
    for key in names:
        if names.count(key) > 1:
            raise SsacError(f"{key} is given more than once")
    for axis in axes:
        _check_once(", ".join(axis[0]), [list(point.values()) for point in axis])
    if grid.search_around_truth_s is not None and "ssac.interval_s" in names:
        raise SsacError("give either search_around_truth_s or ssac.interval_s, not both")
    if grid.figure is not None and grid.figure.x not in grid.varied:
        raise SsacError(f"figure: x = {grid.figure.x!r} is not a parameter that the grid varies")
    for point in (point for axis in axes for point in axis):
        if grid.figure is not None and type(point.get(grid.figure.x, 0)) not in (int, float):
            raise SsacError(f"figure: x = {grid.figure.x!r} has values that are no numbers")
    cells = grid.cells()  # which checks every value
    if flights > 1 and not all(_is_drawn(cell.sim) for cell in cells):
        raise SsacError(
            f"flights must be 1 where sim.trajectory_file is given and the sensor has no noise, got"
            f" {flights}: all flights would be the same, and their runs count as independent ones"
        )
    return grid


_DRAWN_PIXELS = (
    "threshold_mismatch", "leak_hz", "shot_noise_hz", "background_hz", "hot_pixel_share",
)  # fmt: skip
_DRAWN_EFFECTS = (
    "flicker_depth", "dim_noise_on_hz", "dim_noise_off_hz", "hot_clusters", "jitter_s",
    "jitter_lux_s", "frame_phase_spread", "frame_read_noise", "frame_full_well_e",
)  # fmt: skip


def _is_drawn(sim: SimConfig) -> bool:
    """Whether flights of other seeds differ: by a random trajectory, or by a sensor's noise."""
    draws = [getattr(sim.sensor, name) for name in _DRAWN_PIXELS]
    draws += [getattr(sim.effects, name) for name in _DRAWN_EFFECTS]
    return sim.trajectory_file is None or any(draws)


def configs_of(parameters: Mapping[str, Any]) -> tuple[SimConfig, Config]:
    """Set parameters, by dotted names, in the default configurations."""
    given: dict[str, dict[str, Any]] = {root: {} for root in _ROOTS}
    for name, value in parameters.items():
        root, _, path = name.partition(".")
        if root not in given or not path:
            raise SsacError(f"unknown parameter {name!r}: expected sim.<name> or ssac.<name>")
        given[root][path] = _checked_value(name, value, _ROOTS[root], path)
    sim, estimator = (changed(_ROOTS[root], values) for root, values in given.items())
    return sim, estimator


def _checked_value(name: str, value: Any, config: Any, path: str) -> Any:
    """Convert a value to the type of the field that a dotted path names in a nested dataclass."""
    hints = get_type_hints(type(config))
    known = [one.name for one in fields(config)]
    key, _, rest = path.partition(".")
    if key not in known:
        raise SsacError(f"unknown parameter {name!r}: {key!r} is none of {', '.join(known)}")
    if rest:
        if not is_dataclass(getattr(config, key)):
            raise SsacError(f"unknown parameter {name!r}: {key!r} has no parts")
        return _checked_value(name, value, getattr(config, key), rest)
    try:
        return _converted(value, hints[key])
    except TypeError as error:
        raise SsacError(f"{name}: expected {_type_name(hints[key])}, got {value!r}") from error


def changed(default: Changed, values: Mapping[str, Any]) -> Changed:
    """Set fields by dotted names, all at once, since a configuration checks them together."""
    config: Any = default
    changes, parts = dict[str, Any](), dict[str, dict[str, Any]]()
    for name, value in values.items():
        head, _, rest = name.partition(".")
        if rest:
            parts.setdefault(head, {})[rest] = value
        else:
            changes[head] = value
    for head, part in parts.items():
        changes[head] = changed(changes.get(head, getattr(config, head)), part)
    made: Changed = replace(config, **changes)
    return made


def _converted(value: Any, hint: Any) -> Any:
    """Convert a TOML value to the type of a field; TypeError when it has another type."""
    choices = get_args(hint)
    if getattr(hint, "__origin__", None) is tuple:
        if not isinstance(value, (list, tuple)):
            raise TypeError
        kinds = choices[:1] * len(value) if choices[1:] == (...,) else choices
        if len(kinds) != len(value):
            raise TypeError
        return tuple(_converted(item, kind) for item, kind in zip(value, kinds, strict=True))
    if choices:  # a union with None, which TOML lacks
        return _converted(value, next(kind for kind in choices if kind is not type(None)))
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if hint is Path and isinstance(value, str):
        return CONFIGS / value if (CONFIGS / value).is_file() else Path(value)
    if not isinstance(value, hint) or (isinstance(value, bool) and hint is not bool):
        raise TypeError
    return value


def _type_name(hint: Any) -> str:
    choices = [kind for kind in get_args(hint) if kind is not type(None)]
    if len(choices) == 1:  # a union with None
        return _type_name(choices[0])
    return hint.__name__ if isinstance(hint, type) and not choices else str(hint)


def _flat(table: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted names and values of nested tables."""
    if not isinstance(table, Mapping):
        raise SsacError("fixed, grid and together must be tables")
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _axis(axis: str, lists: Mapping[str, Any]) -> tuple[dict[str, Any], ...]:
    """Return the points of an axis along which one parameter, or several together, vary."""
    for name, values in lists.items():
        if not isinstance(values, list) or not values:
            raise SsacError(f"{name}: expected a list of values, got {values!r}")
    if len({len(values) for values in lists.values()}) != 1:
        found = ", ".join(f"{name} has {len(values)}" for name, values in lists.items())
        raise SsacError(f"{axis}: expected lists of one length, but {found or 'none'}")
    points = zip(*lists.values(), strict=True)
    return tuple(dict(zip(lists, values, strict=True)) for values in points)


def _check_once(name: str, values: Sequence[Any]) -> None:
    """Raise SsacError for a value given twice: its runs would count as independent ones."""
    written = [_written(one) for one in values]
    twice = [one for place, one in enumerate(values) if written[place] in written[:place]]
    if twice:
        raise SsacError(
            f"{name}: {twice[0]!r} is given more than once, to the {DIGITS} digits of a table"
        )


def _written(value: Any) -> Any:
    """Return a value as a table tells it from others: numbers have `DIGITS` digits."""
    if isinstance(value, (list, tuple)):
        return [_written(one) for one in value]
    return f"{value:.{DIGITS}g}" if type(value) in (int, float) else value


def _interval(value: Any) -> tuple[float, float] | None:
    if value is None:
        return None
    try:
        low, high = (float(bound) for bound in value)
    except (TypeError, ValueError):
        raise SsacError(f"search_around_truth_s: expected two numbers, got {value!r}") from None
    return low, high


def _figure(table: Any) -> FigureConfig | None:
    hints = get_type_hints(FigureConfig)
    try:
        given = {name: _converted(value, hints[name]) for name, value in (table or {}).items()}
        return None if table is None else FigureConfig(**given)
    except (AttributeError, KeyError, TypeError):
        known = ", ".join(hints)
        raise SsacError(f"figure: expected a table with {known}, got {table!r}") from None
