"""The robust least-squares fit of all refinements, and the covariance of its parameters."""
