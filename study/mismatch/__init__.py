"""What it costs a policy not to know an effect of its machine.

cases         the effects, each over its size
effect_cost   the loss by dynamic programming; sizes: those fixed before any policy was trained
results       what the mismatch experiment keeps in its folder
margin        which table of dynamic programming stands for a trained agent
"""
