"""The paper's tables, our own, their comparison, and the page that shows both."""
