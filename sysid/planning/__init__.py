"""What to play next: the torque that tells effects apart, or that narrows the widest interval."""
