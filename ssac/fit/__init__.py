"""The one robust least squares of all refinements, and the covariance of what it finds."""
