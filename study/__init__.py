"""The main job: what the next real rollout is worth, and what a wider training band costs (`python -m study.main`)."""
