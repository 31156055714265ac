"""Which effect is missing: the screen of all candidates, the search, and the answer."""
