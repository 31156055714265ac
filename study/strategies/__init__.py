"""Published ways to spend real rollouts, on the same rollouts.

strategy     what a strategy may ask for, and what it gives back; catalogue: all of them by name, and a user's own
plant        counts rollouts, and refuses the one beyond the budget
session      a strategy's dialogue with plant and training, as far as there are agents, and rounds of many

identified                    train once, without rollouts or on what was identified; mended by this project's diagnosis
simopt, learned_search, dropo, bayes_sim    adapt what is trained on
readings                      states and summaries of rollouts, which these compare
candidates                    compare returns
learning                      learn on the plant itself

populations, designs                agents that train together, in simulation or on the plant; dynamic programs instead
trial_plan, trial_experiment        cases fixed beforehand, as tasks: rounds of dialogues, agents and designs
trial_findings                      returns over seeds and contrasts, and their tables
strategies_plan, strategies_page    these strategies, compared; what came out, in words, figure and page

The experiment of `study.mismatch` is another plan of such cases.
"""
