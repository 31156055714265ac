"""Data: reading, checking and resampling logs, the noise of their sensors, and how they are split."""
