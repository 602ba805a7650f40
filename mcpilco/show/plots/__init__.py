"""Plots for reports, one on each Axes: the system black, the model blue, its particles grey.

matplotlib comes with the extra `report` and is imported when the first plot is drawn.
"""
