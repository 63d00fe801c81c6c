"""Kinds of figure files and the colours of all figures.

The colours are P. Tol's high-contrast set, which stays apart in grey and for colour-blind people.
"""

FILE_SUFFIXES = (".png", ".pdf", ".svg")

BLUE, YELLOW, RED = "#004488", "#DDAA33", "#BB5566"
