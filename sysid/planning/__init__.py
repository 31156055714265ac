"""Planning: the next experiment, which tells effects apart or narrows the widest interval."""
