"""A path beside a truth: how far they are apart, in time and as shapes."""
