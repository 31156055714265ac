"""How far a model is off, and where: errors on data that no fit has seen, maps, correlations, and words."""
