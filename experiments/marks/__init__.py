"""The marks of recordings as they come: clutter, clocks and intrinsics, each kind with its own."""
