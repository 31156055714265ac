"""Published ways to spend real rollouts, on the same rollouts.

strategy     what a strategy may ask for, and what it gives back; catalogue: all of them by name, and a user's own
plant        counts rollouts, and refuses the one beyond the budget
session      a strategy's dialogue with plant and training, as far as there are agents

The strategies:
    identified       identify, then train once; mended by this project's diagnosis
    simopt, auto_tuned, adapt_sim, dropo, bayes_sim      adapt what is trained on
    readings         states and summaries of rollouts; episode_network: what two of these learn from
    candidates       compare returns (BayRn by gaussian_process, cross-entropy method); learning: on the plant itself

The experiment:
    plan, experiment rounds of dialogues and populations; strategies_results: what is kept
    on_plant         populations that learn on the plant itself
    findings         what came out; sentences, figures, report: how it is told
"""
