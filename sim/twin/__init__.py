"""The paper's small-scale physical experiment: a printed drone on a wire, calibrated cameras."""
