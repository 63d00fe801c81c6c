"""What runs are measured by: columns, labels, units and marks."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """One error of an estimate; less is better."""

    parameter: str  # of the pose and the clock: start of its columns
    unit: str  # end of its columns
    symbol: str  # in plain text
    tex: str  # in a figure
    mark: float  # that no cell's mean of `tangency` is to exceed

    @property
    def column(self) -> str:
        """Name in tables of runs."""
        return f"{self.parameter}_error_{self.unit}"

    @property
    def heading(self) -> str:
        """Head of a column in plain text."""
        return f"{self.symbol} [{self.unit}]"

    @property
    def label(self) -> str:
        """Of a figure's axis."""
        return f"error of {self.tex} [{self.unit}]"


T_D_ERROR = Quantity("t_d", "ms", "t_d", "$t_d$", 0.05)
R_ERROR = Quantity("r", "deg", "R", "R", 0.1)
T_ERROR = Quantity("t", "deg", "t", "t", 0.05)

ERRORS = {error.column: error for error in (T_D_ERROR, R_ERROR, T_ERROR)}
"""All of them, by their columns."""

NOISY_T_D_MARK_MS = 0.1
"""The mark of t_d on the tables' flights with the noise of a DAVIS346."""

POSE_ERRORS = (R_ERROR.column, T_ERROR.column)

ANGLE_LABEL = "angle between the lines of sight [deg]"


def split_quantity(text: str) -> tuple[str, str]:
    """Split `<method>_<error>`; the error is empty when the text ends in none."""
    for error in ERRORS:
        if text.endswith(f"_{error}"):
            return text.removesuffix(f"_{error}"), error
    return text, ""
