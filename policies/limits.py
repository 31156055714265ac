"""What training and judging a policy may cost: sizes that are checked before any memory is taken for them."""

EPISODE_STEPS = 20_000
"""Steps of the integrator in an episode of a policy."""
EPISODES = 100_000
"""Start states from which a policy is judged."""
LAYERS = 20
"""Layers of a policy's network."""
LAYER_WIDTH = 10_000
"""Width of a layer."""
TRAINING_MEMORY = 8e9
"""Bytes that networks, optimisers and transitions of a training take."""
EVALUATION_MEMORY = 2e9
"""Bytes that the widest layer takes for all start states."""
