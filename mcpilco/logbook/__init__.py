"""The record of a run: its folder on disk, its metrics, its callbacks.

An agent calls a `Callback` at each event: `Progress` draws a table, `JsonLines` and `TensorBoard`
write numbers; those of stable-baselines3 are taken too. A `RunFolder` is one run on disk, in plain
formats; `read_history` reads it back as data. Read `callbacks`, `run_folder`, `metrics`,
`history` in this order.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
