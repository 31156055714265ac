"""The torque that a smoother needs beyond a model to follow a log, and what a hand touched."""
