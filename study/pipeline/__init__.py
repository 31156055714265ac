"""What runs a study's tasks: `executor` is the interface, `processes` and `cluster` are behind it."""
