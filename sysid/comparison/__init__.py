"""How far a model is off: errors on data that no fit has seen."""
