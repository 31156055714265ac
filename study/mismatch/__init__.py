"""Does breadth pay when the simulator lacks an effect?

magnitudes, effect_cost     effects over their sizes, and their price
mismatch_plan               plants, strategies, seeds and contrasts; measured: the rollouts of the cases
mismatch_findings           what came out; mismatch_page: its answers in words, figure and page
naming                      how many rollouts naming takes
"""
