"""Many seeds at once: the same training from each, and statistics of their results.

settings = Settings("envs:mcpilco/CartPoleSwingUp-v0")
summary = sweep(settings, range(30), "runs/out/sweep", LocalEngine())

Read `folder.py` first: `sweep` runs a job for each seed that the folder has no result of, and
`SweepFolder` keeps a file a seed, and a summary. A job (`job.py`) is a whole training whose
policies are judged on fresh episodes; an engine (`engines.py`) runs jobs in processes or on a Ray
cluster. `comparison.py` reads several sweeps or runs that are judged alike, and `statistics.py` has
the statistics over seeds of one and of two.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
