"""Pictures of rollouts, models and runs: 3D scenes in Rerun, plots, and pages in HTML.

A `Scene` says how a state looks in 3D: shapes, and their poses. `recording` logs one rollout with
its prediction into an .rrd file, by the parts in `entities` (what is drawn) and `blueprint` (where
the viewer puts it); `film` plays the rollouts of whole runs one after the other, `side_by_side`
motions beside those that models predict. `recorder` fills a run folder while an agent learns,
`follow` shows it meanwhile, `viewer` opens the viewer. `plots` are drawn on the axes of matplotlib:
the system black, the model blue, its particles grey. `report` makes pages of plots and tables that
need no other file. Read `scene`, `recording`, `plots.rollouts`, `report.document` in this order.

Names are imported when first used: Rerun and matplotlib are slow to load, matplotlib is an extra.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
