"""What all commands share: how they are found, their options' ranges, their exit codes."""
