"""The paper's tables, how ours compare with them, and the page of both."""
