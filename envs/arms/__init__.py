"""Robot arms for identification: their models, what moves them, and what their sensors see."""
