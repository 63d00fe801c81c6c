"""What all commands share: how they are found, their options' ranges, progress, exit codes."""
