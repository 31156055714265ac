"""Does breadth pay when the simulator lacks an effect?

What an effect costs, before any training:
    cases         the effects, each over its size; machine: what they act on
    costs         the loss of one case at one size by dynamic programming; effect_cost: all of them, and sizes chosen
    sizes         those that were chosen, fixed before any policy was trained
    margin        which table of dynamic programming stands for a trained agent

The experiment:
    plan          plants, ways, seeds and contrasts; hidden: the plants as machines, and their rollouts; outside:
                  effects that the catalogue lacks
    ways          what each way makes of n rollouts: a recipe; learning, learned: the residual torque of way i
    trainings     agents of recipes that train together; designs: dynamic programs in their place
    experiment    runs all that is missing; results: what is kept
    answer        returns, contrasts, parts of a gap; words, page, figures, titles, report: how it is told

How many rollouts naming takes:
    naming        measures it; named: its rows, and what is right
"""
