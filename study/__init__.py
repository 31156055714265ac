"""The main job: what the next real rollout is worth, and what a wider training band costs (`python -m study.main`).

pipeline     plan -> tasks -> results -> report, for any experiment: executors, storage, progress, pages
paper        the paper's sweep over budgets and widths: protocol, presets, published numbers, reproduction
trials       what the next two share: hidden plants, training setups, agents that are run on the plants
mismatch     does breadth pay when the simulator lacks an effect?
strategies   published ways to spend rollouts, side by side on the same ones
worth        what further rollouts are worth, told before they are measured (`python -m study.worth`)
statistics, formatting, figure_style      what both use
presets      every preset by name, and what runs it; main: the command line
"""
