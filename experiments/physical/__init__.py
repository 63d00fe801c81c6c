"""The paper's small-scale physical experiments as a twin, and what each imperfection costs."""
