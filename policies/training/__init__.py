"""Agents and how they learn: a population of soft actor-critic agents on pendulums of their own, as a TorchRL program.

program        from a model to a policy: the best of several agents
population     the training loop; checkpoint: an unfinished one on disk
sac            the loss: TorchRL's SACLoss over stacked networks, and the same with gradients written out
networks, replay, optimization   what the loop needs beside it, as parts of TorchRL and torch
random_blocks  each agent's own random numbers; cuda_graph: a step launched as one; cpu_settings: settings of a CPU
"""
