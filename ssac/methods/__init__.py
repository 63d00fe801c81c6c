"""The methods by which offset and pose are found, ours and those that ours are compared with."""
