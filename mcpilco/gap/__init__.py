"""Where simulation and measurement disagree, which effect is missing, and what adding it is worth."""
