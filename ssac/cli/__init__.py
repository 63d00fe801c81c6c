"""What a user runs on recordings of their own: the registry of methods, `sync`, its pictures."""
