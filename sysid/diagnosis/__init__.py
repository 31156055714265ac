"""Which effect is missing, how large it is and whether it matters: score tests, search, and the answer."""
