"""Real recordings: what the method finds on public data that are not ours to ship."""
