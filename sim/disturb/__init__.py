"""A recording in; the same with what spoils real ones, clutter and wrong intrinsics, out."""
