"""What a model lacks: how far off it is, where, which effect is missing, and what would tell."""
