"""Data: logs read from files, checked and resampled, the sensors that made them, and how they are split."""
