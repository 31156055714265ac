"""Agents and how they learn: populations of them on pendulums of their own, as TorchRL programs.

program        from a model to a policy: the best of several agents
population     agents trained together, what their settings have in common, and an unfinished training on disk
shac           through the gradient of the model
sac            TorchRL's SACLoss over stacked networks, and the same with gradients written out
networks, replay, optimization   what the loop needs beside it, as parts of TorchRL and torch
random_blocks  each agent's own random numbers; cuda_graph: a step launched as one; cpu_settings: settings of a CPU
"""
