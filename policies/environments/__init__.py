"""What agents act on: a model with the swing-up task.

task                what a step costs, what is observed, where an episode starts
randomization       which parameters an episode draws; random_streams: where random numbers come from
machine             the machine that a policy will meet: a fitted model without what belongs to its log
gymnasium_env       one pendulum as gymnasium.Env
batched_pendulums   a pendulum an agent, all moved at once, as TorchRL's EnvBase
"""
